"""Orientations of an upright hand before the camera, and turns of it within the picture."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

FACING = {
    "palm": ((0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0)),
    "back": ((0.0, 0.0, -1.0), (0.0, -1.0, 0.0), (-1.0, 0.0, 0.0)),
}
"""Images of the hand's x, y and z axes in the camera frame, by the side that the camera sees. The left hand's are the
same, its frame being mirrored."""


def facing_rotation(facing: str, *, dtype: torch.dtype = torch.float64) -> Float[Tensor, "3 3"]:
    """cam_from_hand of an upright hand, left or right, that shows its palm or its back.

    Raises ValueError for any other side.
    """
    if facing not in FACING:
        raise ValueError(f"facing: expected one of {', '.join(FACING)}, got {facing!r}")
    axes = torch.tensor(FACING[facing], dtype=dtype)
    return axes.T.contiguous()


def turned_in_picture(rotation: Float[Tensor, "3 3"], angle: float) -> Float[Tensor, "3 3"]:
    """The orientation after a turn about the optical axis, radians, clockwise in the picture."""
    c, s = math.cos(angle), math.sin(angle)
    return torch.tensor(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)), dtype=rotation.dtype) @ rotation
