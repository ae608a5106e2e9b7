"""A million steps of every filter on hostile input: what comes out is a belief, every time."""

import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import torch
from jaxtyping import Bool
from torch import Tensor

from torchhand.numerics import (
    Gaussian,
    Measurement,
    MotionModel,
    UnscentedSettings,
    Update,
    predict,
    predict_linear,
    sigma_points,
    update,
    update_extended,
    update_iterated,
)
from torchhand.study.soak.hostile import DOFS, STEPS_S, Hostile

_TOLERANCE = 4.0  # times the dtype's rounding and the number of states: what a product of square roots may be off

Correction = Callable[[Hostile, Gaussian, Measurement, "float | None"], Update]


@dataclass(frozen=True, kw_only=True)
class SoakSettings:
    """How long filters run."""

    steps: int = 1_000_000
    """Steps (a prediction and an update of one filter) over all kinds and dtypes; 1 or more."""
    filters: int = 128
    """Filters of one kind and dtype that run side by side; 1 or more."""
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("steps", "filters"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}: expected 1 or more, got {getattr(self, name)!r}")


@dataclass(frozen=True, kw_only=True)
class SoakResult:
    """What went wrong, by kind and dtype."""

    steps: Mapping[str, int]
    """Steps of each."""
    faults: Mapping[str, int]
    """Beliefs that were not finite, not symmetric or not positive semi-definite, and calls that raised."""
    lowest: Mapping[str, float]
    """Smallest eigenvalue of all covariances in units of each state's own deviation, in units of the rounding."""
    seconds: float


def _unscented(
    world: Hostile,
    state: Gaussian,
    seen: Measurement,
    gate: float | None,
    *,
    settings: UnscentedSettings,
    observed: bool,
) -> Update:
    return update(state, world.observe, seen, settings, gate=gate, observed=DOFS if observed else None)


def _from_points(world: Hostile, state: Gaussian, seen: Measurement, gate: float | None) -> Update:
    points = sigma_points(state, UnscentedSettings()).points
    return update(state, world.observe, seen, gate=gate, points=points)


def _extended(world: Hostile, state: Gaussian, seen: Measurement, gate: float | None) -> Update:
    value, jacobian = world.linearised(state.mean)
    return update_extended(state, seen.value - value, jacobian, seen.noise, valid=seen.valid, gate=gate)


def _correlated(world: Hostile, state: Gaussian, seen: Measurement, gate: float | None) -> Update:
    value, jacobian = world.linearised(state.mean)
    noise = world.correlated(seen)
    return update_extended(state, seen.value - value, jacobian, noise, valid=seen.valid, gate=gate, group=2)


def _iterated(world: Hostile, state: Gaussian, seen: Measurement, gate: float | None) -> Update:
    found = update_iterated(state, world.linearised, seen, gate=gate, observed=DOFS)
    return found.update


KINDS: Mapping[str, Correction] = {
    "unscented": partial(_unscented, settings=UnscentedSettings(), observed=False),
    "unscented_paper": partial(_unscented, settings=UnscentedSettings(variant="paper"), observed=False),
    "unscented_negative_centre": partial(_unscented, settings=UnscentedSettings(alpha=0.5, beta=0.0), observed=False),
    "unscented_observed": partial(_unscented, settings=UnscentedSettings(), observed=True),
    "unscented_points": _from_points,
    "extended": _extended,
    "extended_correlated": _correlated,
    "iterated": _iterated,
}
"""Measurement updates by what is special to them."""
_DTYPES = (torch.float32, torch.float64)


def soak_filters(settings: SoakSettings, progress: Callable[[int], None] = lambda steps: None) -> SoakResult:
    """Run all KINDS in float32 and float64, each a share of the steps, and judge every belief.

    progress: called with the steps done since it was last called.
    """
    started = time.perf_counter()
    steps, faults, lowest = Counter(), Counter(), {}
    rounds = -(-settings.steps // (settings.filters * len(KINDS) * len(_DTYPES)))
    for number, (name, correct) in enumerate(KINDS.items()):
        for dtype in _DTYPES:
            label = f"{name}, {str(dtype).removeprefix('torch.')}"
            generator = torch.Generator().manual_seed(settings.seed * len(KINDS) + number)
            run = _Run(correct, settings.filters, dtype, generator, is_linear=number > 0)
            for _ in range(rounds):
                run.step()
                progress(settings.filters)
            steps[label], lowest[label] = rounds * settings.filters, run.lowest
            faults.update({f"{label}: {fault}": count for fault, count in run.faults.items()})
    return SoakResult(steps=steps, faults=faults, lowest=lowest, seconds=time.perf_counter() - started)


class _Run:
    """Filters of one kind and dtype, step by step."""

    def __init__(
        self, correct: Correction, count: int, dtype: torch.dtype, generator: torch.Generator, *, is_linear: bool
    ) -> None:
        self.correct, self.dtype, self.is_linear = correct, dtype, is_linear
        motion = MotionModel(order=2, velocity_decay_s=0.5, acceleration_decay_s=0.2)
        self.world = Hostile(count, motion, dtype, generator)
        self.state = self.world.begin()
        self.wrong = torch.zeros(count, dtype=torch.bool)
        self.faults: Counter[str] = Counter()
        self.lowest = 0.0
        self.done = 0

    def step(self) -> None:
        """Predict, measure, correct, judge; filters with a fault begin anew."""
        world, dt_s = self.world, STEPS_S[self.done % len(STEPS_S)]
        gate = (9.0, None)[self.done // len(STEPS_S) % 2]
        self.done += 1
        self.state = world.restarted(self.state, self.wrong)
        self.wrong = torch.zeros_like(self.wrong)
        transition = world.motion.transition(dt_s, DOFS, dtype=self.dtype)
        world.move(transition)
        seen = world.measure()
        try:
            noise = world.process_noise(dt_s)
            if self.is_linear:
                predicted = predict_linear(self.state, transition, noise)
            else:
                predicted = predict(self.state, lambda points: world.swayed(points, transition), noise)
            self._judge(predicted, "prediction")
            result = self.correct(world, predicted, seen, gate)
        except Exception as error:  # whatever it is, it is counted
            self.faults[f"{type(error).__name__}: {error}"] += 1
            self.wrong[:] = True
            return
        self._judge(result.state, "update")
        self._count("innovation not finite", ~result.innovation.isfinite().all(-1))
        self._count("innovation's variance not above 0", ~(result.innovation_variance > 0).all(-1))
        self._count("NIS not finite or below 0", ~(result.nis.isfinite() & (result.nis >= 0)))
        self.state = result.state

    def _judge(self, belief: Gaussian, of: str) -> None:
        is_finite = belief.mean.isfinite().all(-1) & belief.covariance.isfinite().all((-2, -1))
        self._count(f"{of} not finite", ~is_finite)
        covariance = torch.where(is_finite[:, None, None], belief.covariance, 0.0).double()
        self._count(f"{of} not symmetric", (covariance != covariance.mT).any((-2, -1)))
        # In units of each state's own deviation: what is small beside another state counts as much.
        variance = covariance.diagonal(dim1=-2, dim2=-1)
        scale = torch.where(variance > 0, variance.rsqrt(), 1.0)
        rounding = torch.finfo(self.dtype).eps * covariance.shape[-1]
        lowest = torch.linalg.eigvalsh(scale[:, :, None] * covariance * scale[:, None, :])[:, 0] / rounding
        self.lowest = min(self.lowest, float(lowest.min()))
        self._count(f"{of} not positive semi-definite", lowest < -_TOLERANCE)

    def _count(self, fault: str, wrong: Bool[Tensor, "filters"]) -> None:
        if bool(wrong.any()):
            self.faults[fault] += int(wrong.sum())
            self.wrong |= wrong
