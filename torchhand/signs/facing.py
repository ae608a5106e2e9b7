"""Where the hand turns in a sign: orientations before the viewer, right hands; left ones are their mirror images."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.fit.detect import facing_rotation
from torchhand.geometry import rotation_from_vector
from torchhand.hand import Side
from torchhand.signs.table import FACINGS, Facing

_ABOUT_UP_DEG = {"palm": 0.0, "quarter": 32.0, "side": 58.0, "back": 180.0}
"""Turn of the palm from the viewer to the signer's other side."""
# Images of the hand's x (out of its back), y (along the fingers) and z (thumb's side) in the camera frame (x right, y
# down, z forward).
_ACROSS = ((0.0, 0.0, -1.0), (1.0, 0.0, 0.0), (0.0, -1.0, 0.0))
_DOWN = ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
_ACROSS_TILT_DEG = (0.0, 20.0, 0.0)
_DOWN_TILT_DEG = (-20.0, 38.0, 0.0)


def sign_rotation(sign: str, side: Side = "right") -> Float[Tensor, "3 3"]:
    """cam_from_hand of one of SIGNS, float64.

    palm, back: upright, the palm or the back to the viewer. quarter, side: turned so that the palm looks more and more
    to the viewer's right. across: fingers to the viewer's right, the back to the viewer. down: the palm down. Of a left
    hand mirrored.
    """
    rotation = _right(FACINGS.get(sign, "palm"))
    if side == "right":
        return rotation
    flip = rotation.new_tensor((-1.0, 1.0, 1.0)), rotation.new_tensor((1.0, 1.0, -1.0))
    return flip[0][:, None] * rotation * flip[1]


def _right(facing: Facing) -> Float[Tensor, "3 3"]:
    if facing in _ABOUT_UP_DEG:
        return _turn((0.0, -_ABOUT_UP_DEG[facing], 0.0)) @ facing_rotation("palm")
    axes, tilt = (_ACROSS, _ACROSS_TILT_DEG) if facing == "across" else (_DOWN, _DOWN_TILT_DEG)
    return _turn(tilt) @ torch.tensor(axes, dtype=torch.float64).T


def _turn(degrees: tuple[float, float, float]) -> Float[Tensor, "3 3"]:
    vector = torch.tensor(degrees, dtype=torch.float64)
    return rotation_from_vector(torch.deg2rad(vector))
