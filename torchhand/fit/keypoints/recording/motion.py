"""How fast the numbers of a pose change, and how much of their error is new in every frame: by maximum likelihood."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

_ACCELERATIONS = 12  # trials
_ACCELERATION_RANGE = (1e-4, 1.0)  # of an acceleration from frame to frame, over the spread of the number's steps
_FRESH = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)
_FREEDOM = 4.0  # degrees of freedom of the t distribution of innovations


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Constant velocity but for white accelerations, every number of a pose by itself."""

    acceleration: Float[Tensor, "free"]
    """Variance of a velocity's change from one frame to the next, in the numbers' unit and frames."""
    fresh: Float[Tensor, "free"]
    """Share of the variance of an estimate's error that is new in every frame, 0 to 1; the rest it has in common with
    its neighbours, and no smoothing takes it away."""


def motion_of(
    values: Float[Tensor, "frames free"], variance: Float[Tensor, "frames free"], is_known: Bool[Tensor, "frames"]
) -> Motion:
    """The motion under which the estimates of a recording are likeliest, its frames at equal distances in time.

    variance: of the estimates. Every number is followed by itself through a Kalman filter with Student's t innovations,
    for every trial at once.
    """
    known = values[is_known]
    steps = known.diff(dim=0).abs()
    size = steps.quantile(0.95, dim=0).clamp_min(1e-6) if len(steps) else values.new_ones(values.shape[1])
    low, high = (math.log(one) for one in _ACCELERATION_RANGE)
    trials = torch.linspace(low, high, _ACCELERATIONS).to(values).exp()
    fresh = values.new_tensor(_FRESH)
    acceleration = (trials[:, None, None] * size).square().expand(-1, len(fresh), -1)
    cost = _cost(values, variance, is_known, acceleration, fresh[:, None])
    best = cost.flatten(0, 1).argmin(0)
    each = torch.arange(values.shape[1], device=values.device)
    return Motion(acceleration=acceleration.flatten(0, 1)[best, each], fresh=fresh[best % len(fresh)])


def _cost(
    values: Tensor, variance: Tensor, is_known: Tensor, acceleration: Float[Tensor, "a f free"], fresh: Tensor
) -> Float[Tensor, "a f free"]:
    """Negative log-likelihood of the estimates for every trial."""
    first = int(is_known.nonzero()[0, 0])
    place, speed = values[first].expand_as(acceleration), torch.zeros_like(acceleration)
    p00 = (fresh * variance[first]).expand_as(acceleration)
    p01, p11 = torch.zeros_like(p00), 10 * acceleration + variance[first]
    cost = torch.zeros_like(p00)
    for row in range(first + 1, len(values)):
        place = place + speed
        p00, p01, p11 = p00 + 2 * p01 + p11 + acceleration / 3, p01 + p11 + acceleration / 2, p11 + acceleration
        if not bool(is_known[row]):
            continue
        missed, noise = values[row] - place, fresh * variance[row]
        spread = p00 + noise
        away = missed.square() / spread
        cost = cost + 0.5 * spread.log() + 0.5 * (_FREEDOM + 1) * (away / _FREEDOM).log1p()
        noise = noise * (_FREEDOM + away) / (_FREEDOM + 1)
        gain0, gain1 = p00 / (p00 + noise), p01 / (p00 + noise)
        place, speed = place + gain0 * missed, speed + gain1 * missed
        p00, p01, p11 = (1 - gain0) * p00, (1 - gain0) * p01, p11 - gain1 * p01
    return cost
