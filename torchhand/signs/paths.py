"""What the hand itself does during a sign: J and Z are traced in the air, the others hold still."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.geometry import rotation_from_vector
from torchhand.hand import Side
from torchhand.numerics import ease
from torchhand.signs.facing import sign_rotation

TRACERS = {"J": "little_tip", "Z": "index_tip"}
"""Signs that are traced in the air, and the keypoint that traces them."""
_Z_CORNERS = ((0.045, -0.03), (-0.045, -0.03), (0.045, 0.035), (-0.045, 0.035))
"""Right and down in the viewer's picture, metres: a Z as the signer sees it."""
_J_STEM, _J_HOOK, _J_TURN_DEG = 0.055, 0.024, 100.0
_STEM_FRACTION = 0.45  # of the time


def hand_course(
    sign: str, fraction: Float[Tensor, "frames"], side: Side = "right"
) -> tuple[Float[Tensor, "frames 3"], Float[Tensor, "frames 3 3"]]:
    """Displacement of the hand's middle, metres, and cam_from_hand, over the time of a sign (share 0 to 1); float64.

    Camera axes: x right, y down, z forward. A J is drawn downwards with a hook towards the signer's other side, while
    the hand turns its palm to the signer; left hands do the mirror image.
    """
    fraction = fraction.double()
    rotation = sign_rotation(sign).expand(len(fraction), 3, 3)
    offset = fraction.new_zeros(len(fraction), 3)
    if sign == "Z":
        corners = torch.tensor(_Z_CORNERS, dtype=torch.float64)
        strokes = len(corners) - 1
        stroke = (fraction * strokes).floor().clamp(0, strokes - 1).long()
        along = ease(fraction * strokes - stroke)[:, None]
        offset[:, :2] = corners[stroke] + along * (corners[stroke + 1] - corners[stroke])
    elif sign == "J":
        down = ease(fraction / _STEM_FRACTION)
        bend = math.pi * ease((fraction - _STEM_FRACTION) / (1 - _STEM_FRACTION))
        offset[:, 0] = _J_HOOK * (1 - bend.cos())
        offset[:, 1] = _J_STEM * (down - 0.5) + _J_HOOK * (bend.sin() - 0.6)
        turn = torch.zeros_like(offset)
        turn[:, 1] = -math.radians(_J_TURN_DEG) * bend / math.pi
        rotation = rotation_from_vector(turn) @ rotation
    if side == "left":
        flip = torch.tensor((-1.0, 1.0, 1.0), dtype=torch.float64)
        mirror = torch.tensor((1.0, 1.0, -1.0), dtype=torch.float64)
        offset, rotation = offset * flip, flip[:, None] * rotation * mirror
    return offset, rotation
