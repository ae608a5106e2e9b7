"""Which piece is which finger: a sweep across the hand's axis, checked against the plan of an open hand."""

import itertools
from dataclasses import dataclass

import numpy as np

Point = tuple[float, float]

DIGITS = ("thumb", "index", "middle", "ring", "little")

# Plan of a right hand's back, fingers up and spread, the wrist at the origin, x to the right and y down, shares of hand
# length: where each digit leaves the palm, and its tip. From the ratios of Buchholz et al. (1992) at medium spread.
_BASES = np.array(((-0.28, -0.20), (-0.145, -0.583), (0.0, -0.586), (0.116, -0.547), (0.234, -0.496)))
_TIPS = np.array(((-0.555, -0.38), (-0.228, -0.918), (0.0, -0.99), (0.18, -0.917), (0.342, -0.747)))
_PALM = np.array((0.0, -0.32))
_PALM_RADIUS = 0.205
_BASE_WEIGHTS = np.array((0.4, 1.0, 1.0, 1.0, 1.0))
_TIP_WEIGHTS = np.array((0.35, 0.7, 0.7, 0.7, 0.6))
_PALM_WEIGHT = 1.0
_WORST_MISFIT = 0.14  # root mean square over hand length; above it, it is no hand
_PALM_SIZE_WEIGHT = 0.1  # of the logarithm of the palm's size over the plan's
_MIN_FINGERS = 2
_SCALES = (0.7, 1.5)  # of the palm's disc over the plan's


@dataclass(frozen=True, kw_only=True)
class FingerOrder:
    """Digits found among some pieces."""

    fingers: dict[str, int]
    """Index of the piece by digit, thumb to little; the digits that were found."""
    is_mirrored: bool
    """False where the thumb lies on the left of upright fingers (a right hand's back, a left hand's palm)."""
    misfit: float
    """Weighted root mean square distance from the plan, over hand length."""
    wrist: Point
    """Position of the wrist by the plan, px."""
    axis: Point
    """Unit vector from the wrist along the middle finger, as the plan lies."""
    hand_length: float
    """Length of the hand by the plan, px."""


def order_fingers(
    tips: list[Point], bases: list[Point], palm_centre: Point, palm_radius: float, max_tips: int = 8
) -> FingerOrder | None:
    """The largest set of pieces that agrees with the plan of an open hand, as many as five; None where no two do.

    Every piece has its place in a sweep around the palm, so a choice of pieces and of the first digit fixes which is
    which; the plan is laid over tips, bases and the palm's centre by the similarity that fits best, as it is and
    mirrored, and the choice that fits best among the largest that fit is taken.
    """
    count = min(len(tips), max_tips)
    if count < _MIN_FINGERS:
        return None
    unit = np.array((1.0, 1.0j))
    tip, base, palm = np.array(tips[:count]) @ unit, np.array(bases[:count]) @ unit, complex(*palm_centre)
    sweep = np.argsort(np.angle(tip + base - 2 * palm))
    for size in range(min(5, count), _MIN_FINGERS - 1, -1):
        pieces, digits = _choices(sweep, size)
        found = _best(pieces, digits, tip, base, palm, palm_radius)
        if found is not None and found.misfit < _WORST_MISFIT:
            return found
    return None


def _choices(sweep: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Pieces (n, size) in the order of the sweep, from every first one, and the digits (m, size) they may be."""
    chosen = np.array(list(itertools.combinations(sweep, size)))
    pieces = np.concatenate([np.roll(chosen, turn, axis=1) for turn in range(size)])
    return pieces, np.array(list(itertools.combinations(range(5), size)))


def _best(
    pieces: np.ndarray, digits: np.ndarray, tip: np.ndarray, base: np.ndarray, palm: complex, palm_radius: float
) -> FingerOrder | None:
    """The choice over which the plan lies best, by least-squares similarities, among those with a palm of its size."""
    size = pieces.shape[1]
    seen = np.concatenate((tip[pieces], base[pieces], np.full((len(pieces), 1), palm)), 1)[:, None, None]
    unit = np.array((1.0, 1.0j))
    index = np.stack((digits, digits[:, ::-1]), 1)  # mirrored, the sweep meets the little finger first
    plan = np.concatenate(
        ((_TIPS @ unit)[index], (_BASES @ unit)[index], np.full((*index.shape[:2], 1), _PALM @ unit)), 2
    )
    plan[:, 1] = -plan[:, 1].conj()
    weight = np.concatenate(
        (_TIP_WEIGHTS[index], _BASE_WEIGHTS[index], np.full((*index.shape[:2], 1), _PALM_WEIGHT)), 2
    )
    weight = weight / weight.sum(-1, keepdims=True)
    plan_mean = (weight * plan).sum(-1, keepdims=True)
    seen_mean = (weight * seen).sum(-1, keepdims=True)
    away = plan - plan_mean
    turn = (weight * away.conj() * (seen - seen_mean)).sum(-1) / (weight * np.abs(away) ** 2).sum(-1)
    length = np.maximum(np.abs(turn), 1e-9)
    error = np.abs(seen - seen_mean - turn[..., None] * away) ** 2
    misfit = np.sqrt((weight * error).sum(-1)) / length
    ratio = palm_radius / (_PALM_RADIUS * length)
    misfit = np.hypot(misfit, _PALM_SIZE_WEIGHT * np.log(ratio))
    misfit[(ratio < _SCALES[0]) | (ratio > _SCALES[1])] = np.inf
    piece, digit, mirror = np.unravel_index(int(misfit.argmin()), misfit.shape)
    if not np.isfinite(misfit[piece, digit, mirror]):
        return None
    wrist = complex(seen_mean[piece, digit, mirror, 0] - turn[piece, digit, mirror] * plan_mean[digit, mirror, 0])
    axis = complex(turn[piece, digit, mirror] * -1.0j / length[piece, digit, mirror])
    named = sorted((int(index[digit, mirror, i]), int(pieces[piece, i])) for i in range(size))
    return FingerOrder(
        fingers={DIGITS[number]: place for number, place in named},
        is_mirrored=bool(mirror),
        misfit=float(misfit[piece, digit, mirror]),
        wrist=(wrist.real, wrist.imag),
        axis=(axis.real, axis.imag),
        hand_length=float(length[piece, digit, mirror]),
    )
