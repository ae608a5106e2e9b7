"""What lies beyond the wrist of a posed hand: a forearm, nothing, or something that is neither."""

import itertools
import math
from collections.abc import Sequence
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
_BENT_FROM = 0.04
"""Area from which on the elbow is looked for: what of one in a hundred simulated right hands is no forearm."""
_ELBOWS = (0.35, 0.45, 0.55)  # hand lengths from the wrist, where the forearm is seen shortened
_BENT_DEG = (-145.0, -120.0, -95.0, 95.0, 120.0, 145.0)
"""Of the upper arm to the forearm: it hangs beside the body, before which the hand is held."""
_UPPER_BREADTHS, _UPPER_LENGTHS = (0.3, 0.42), (0.4, math.inf)
"""Of the upper arm, until a sleeve. One of 0.54 would explain the palm of a hand on whose two fingers another one is
laid."""
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
    anywhere, for a sleeve may hide it: also at once. Where the elbow is near in the picture, an upper arm begins there.
    The palm of a larger hand, other fingers and a body are none.
    """
    places, forearms = _places(), _forearms()
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
    weight = counts.to(forearms) - 2 * seen  # a + b - 2 ab: the symmetric difference
    differing = seen.sum() + forearms @ weight
    if float(differing.min()) * _STEP**2 > _BENT_FROM:
        differing = torch.cat((differing, seen.sum() + _bent(weight)))
    return float(differing.min()) * _STEP**2


def _bent(weight: Float[Tensor, "places"]) -> Float[Tensor, "arms"]:
    """Sums of the weights of the places that bent arms cover: with every upper arm the forearm that fits best."""
    forearms, uppers = _bent_arms()
    fore = forearms @ weight
    best = fore.argmin(1)
    rest = weight * (1 - forearms[torch.arange(len(best)), best])
    return (fore.gather(1, best[:, None]) + torch.einsum("eup,ep->eu", uppers, rest)).flatten()


@lru_cache(maxsize=1)
def _places() -> Float[Tensor, "places 2"]:
    """Along and across the arm, hand lengths from the wrist."""
    along = torch.arange(0.5 * _STEP, _ALONG, _STEP, dtype=torch.float64)
    across = torch.arange(0.5 * _STEP - _ACROSS, _ACROSS, _STEP, dtype=torch.float64)
    return torch.cartesian_prod(along, across)


def _turned(along: Tensor, across: Tensor, angle_deg: float) -> tuple[Tensor, Tensor]:
    """Coordinates along and across a direction at an angle to another one, from those of that."""
    angle = math.radians(angle_deg)
    return along * math.cos(angle) + across * math.sin(angle), across * math.cos(angle) - along * math.sin(angle)


def _bars(turn_deg: float, offset: float, ends: Sequence[float]) -> Bool[Tensor, "bars places"]:
    """Which places forearms of every breadth cover that end somewhere; turned, and beside the wrist's middle."""
    along, across = _places().unbind(-1)
    u, v = _turned(along, across - offset, turn_deg)
    kinds = itertools.product(_BREADTHS, _THICKENINGS, ends)
    return torch.stack([(v.abs() <= 0.5 * (wide + more * u.clamp_min(0.0))) & (u <= end) for wide, more, end in kinds])


@lru_cache(maxsize=1)
def _forearms() -> Float[Tensor, "forearms places"]:
    """Which places each forearm covers (0 or 1)."""
    found = [_bars(turn, offset, _ENDS) for turn, offset in itertools.product(_TURNS_DEG, _OFFSETS)]
    return torch.cat(found).unique(dim=0).float()


@lru_cache(maxsize=1)
def _bent_arms() -> tuple[Float[Tensor, "elbows forearms places"], Float[Tensor, "elbows uppers places"]]:
    """Which places forearms as far as every elbow cover, and upper arms from there on (0 or 1)."""
    (along, across), forearms, uppers = _places().unbind(-1), [], []
    for turn, offset, elbow in itertools.product(_TURNS_DEG, _OFFSETS, _ELBOWS):
        forearms.append(_bars(turn, offset, (elbow,)))
        u, v = _turned(along, across - offset, turn)
        bars = []
        for bend, breadth, length in itertools.product(_BENT_DEG, _UPPER_BREADTHS, _UPPER_LENGTHS):
            on, aside = _turned(u - elbow, v, bend)
            is_joint = on.square() + aside.square() <= (0.5 * breadth) ** 2
            bars.append(is_joint | ((aside.abs() <= 0.5 * breadth) & (on >= 0) & (on <= length)))
        uppers.append(torch.stack(bars))
    return torch.stack(forearms).float(), torch.stack(uppers).float()
