"""What lies beyond the wrist of a posed hand: a forearm, nothing, or something that is neither."""

import itertools
import math
from functools import lru_cache

import torch
from jaxtyping import Bool, Float
from torch import Tensor

_STEP = 0.04  # distance between two samples, hand lengths
_ALONG = 0.6  # samples reach so far towards the elbow, hand lengths: farther away other things cross the arm
_ACROSS = 0.8  # and so far to either side
_TURNS_DEG = (-60.0, -45.0, -30.0, -15.0, 0.0, 15.0, 30.0, 45.0, 60.0)  # of the wrist, as seen in the picture
_BREADTHS = (
    0.18,
    0.24,
    0.30,
    0.36,
    0.42,
)  # of the wrist: a thin one from the side to a thick one from the front (ANSUR II)
_THICKENINGS = (0.0, 0.25, 0.5)  # breadth gained per length towards the elbow; a cone from 0.33 to 0.55 in 1.3: 0.17
_ENDS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, math.inf)  # where a sleeve begins, hand lengths from the wrist
_OFFSETS = (-0.08, 0.0, 0.08)  # of the wrist's middle across, hand lengths


def forearm_mismatch(
    picture: Bool[Tensor, "height width"],
    model: Bool[Tensor, "height width"],
    wrist_px: Float[Tensor, "2"],
    towards_elbow: Float[Tensor, "2"],
    length_px: float,
    *,
    may_be_there: bool = True,
) -> float:
    """Area by which the picture beyond the wrist differs from the forearm that fits best, squares of the hand's length.

    picture: silhouette of hand and arm. model: that of the posed hand; what it covers does not count, nor does what is
    outside the picture. towards_elbow: unit vector in the picture. length_px: the hand's length, held parallel to the
    picture. may_be_there: whether a forearm can be; else whatever is there is none.

    A forearm is a bar that begins at the wrist, as broad as a wrist can be, gets broader towards the elbow and ends
    anywhere, for a sleeve may hide it: also at once. The palm of a larger hand, other fingers and a body are none.
    """
    places, forearms = _forearms()
    along, across = towards_elbow.double().cpu(), towards_elbow.double().cpu().flip(0) * torch.tensor((1.0, -1.0))
    pixels = wrist_px.double().cpu() + length_px * (places[:, :1] * along + places[:, 1:] * across)
    x, y = pixels.round().long().unbind(-1)
    height, width = picture.shape
    is_inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    x, y = x.clamp(0, width - 1), y.clamp(0, height - 1)
    counts = is_inside & ~model.cpu()[y, x]
    seen = (counts & picture.cpu()[y, x]).to(forearms)
    if not bool(seen.any()):
        return 0.0
    if not may_be_there:
        return float(seen.sum()) * _STEP**2
    differing = seen.sum() + forearms @ (counts.to(forearms) - 2 * seen)  # a + b - 2 ab: the symmetric difference
    return float(differing.min()) * _STEP**2


@lru_cache(maxsize=1)
def _forearms() -> tuple[Float[Tensor, "places 2"], Float[Tensor, "forearms places"]]:
    """Places along and across the arm, hand lengths from the wrist, and which of them each forearm covers (0 or 1)."""
    along = torch.arange(0.5 * _STEP, _ALONG, _STEP, dtype=torch.float64)
    across = torch.arange(0.5 * _STEP - _ACROSS, _ACROSS, _STEP, dtype=torch.float64)
    places = torch.cartesian_prod(along, across)
    found = []
    for turn, offset in itertools.product(_TURNS_DEG, _OFFSETS):
        cosine, sine = math.cos(math.radians(turn)), math.sin(math.radians(turn))
        u = places[:, 0] * cosine + (places[:, 1] - offset) * sine
        v = (places[:, 1] - offset) * cosine - places[:, 0] * sine
        for breadth, thickening, end in itertools.product(_BREADTHS, _THICKENINGS, _ENDS):
            found.append((v.abs() <= 0.5 * (breadth + thickening * u.clamp_min(0.0))) & (u <= end))
    return places, torch.stack(found).unique(dim=0).float()
