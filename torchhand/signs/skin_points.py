"""Named points on the surface of the digits, from the primitives: where signs touch."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.hand import CONE_NAMES, FINGERS, Primitives


@dataclass(frozen=True, kw_only=True)
class SkinPoint:
    """A place on a segment's cone."""

    segment: str
    """One of CONE_NAMES but the palm."""
    along: float
    """Share of the cone, 0 at its beginning; above 1 on the rounded tip."""
    palmar: float
    """Direction around the segment, degrees: 0 towards the thumb's side, 90 to the palmar side, 180 away from the
    thumb, −90 to the back."""


PAD, SIDE, BACK = 90.0, 0.0, -90.0

POINTS: dict[str, SkinPoint] = {
    **{f"{finger}_pad": SkinPoint(segment=f"{finger}_distal", along=0.75, palmar=PAD) for finger in FINGERS},
    **{f"{finger}_back": SkinPoint(segment=f"{finger}_middle", along=0.45, palmar=BACK) for finger in FINGERS[1:]},
    **{f"{finger}_side": SkinPoint(segment=f"{finger}_proximal", along=0.75, palmar=SIDE) for finger in FINGERS[1:]},
}
TIPS = tuple(f"{finger}_tip" for finger in FINGERS)
PALM = "palm_middle"
POINT_NAMES = (*POINTS, *TIPS, PALM)
"""Pads, backs of the middle segments, sides (towards the thumb) of the proximal ones; the very tips; the palm below the
middle finger."""

_BELOW_KNUCKLE = 0.25  # share of the palm's cone


def skin_points(primitives: Primitives) -> Float[Tensor, "*batch points 3"]:
    """Places of POINT_NAMES of right hands, metres, in the frame of the primitives."""
    sizes = primitives.sizes
    rows = torch.tensor([CONE_NAMES.index(point.segment) for point in POINTS.values()])
    tips = torch.tensor([CONE_NAMES.index(f"{finger}_distal") for finger in FINGERS])
    like = primitives.position
    along = torch.tensor([point.along for point in POINTS.values()], dtype=like.dtype)
    turn = torch.tensor([math.radians(point.palmar) for point in POINTS.values()], dtype=like.dtype)
    rotation, position = primitives.cone_rotation[..., rows, :, :], primitives.cone_position[..., rows, :]
    start = sizes.cone_start[..., rows, 0]
    radius = start * (1 + along * (sizes.cone_end_scale[..., rows] - 1))
    local = torch.stack((-turn.sin() * radius, along * sizes.cone_length[..., rows], turn.cos() * radius), -1)
    on_segments = position + (rotation @ local[..., None]).squeeze(-1)
    reach = sizes.cone_length[..., tips] + sizes.cone_start[..., tips, 0] * sizes.cone_end_scale[..., tips]
    at_tips = primitives.cone_position[..., tips, :] + primitives.cone_rotation[..., tips, :, 1] * reach[..., None]
    palm = CONE_NAMES.index("palm")
    fraction = 1 - _BELOW_KNUCKLE
    depth = sizes.cone_start[..., palm, 0] * (1 + fraction * (sizes.cone_end_scale[..., palm] - 1))
    below = torch.stack((-depth, fraction * sizes.cone_length[..., palm], torch.zeros_like(depth)), -1)
    on_palm = (
        primitives.cone_position[..., palm, :] + (primitives.cone_rotation[..., palm, :, :] @ below[..., None])[..., 0]
    )
    return torch.cat((on_segments, at_tips, on_palm[..., None, :]), -2)
