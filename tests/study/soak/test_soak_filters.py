"""The soak: filters that run on hostile input, and that it would see what goes wrong."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import pytest
import torch

from torchhand.numerics import Gaussian, MotionModel
from torchhand.study.soak import filters
from torchhand.study.soak.filters import KINDS, SoakSettings, soak_filters
from torchhand.study.soak.hostile import DOFS, Hostile

STEPS = 4_000


def test_every_belief_is_one() -> None:
    found = soak_filters(SoakSettings(steps=STEPS, filters=32, seed=1))
    assert found.faults == {}
    assert sum(found.steps.values()) >= STEPS
    assert len(found.steps) == 2 * len(KINDS)
    assert min(found.lowest.values()) > -4


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 3])
def test_every_belief_is_one_for_long(seed: int) -> None:
    found = soak_filters(SoakSettings(steps=300_000, seed=seed))
    assert found.faults == {}


def _but(changed: Callable[[Gaussian], Gaussian], *arguments: Any) -> Any:
    result = KINDS["extended"](*arguments)
    return replace(result, state=changed(result.state))


def _negative(state: Gaussian) -> Gaussian:
    covariance = state.covariance.clone()
    covariance[3] = torch.eye(len(covariance[3]))
    covariance[3, 0, 1] = covariance[3, 1, 0] = 1.001
    return Gaussian(state.mean, covariance)


def _lopsided(state: Gaussian) -> Gaussian:
    covariance = state.covariance.clone()
    covariance[5, 0, 1] += covariance[5, 0, 0] + 1
    return Gaussian(state.mean, covariance)


def _lost(state: Gaussian) -> Gaussian:
    return Gaussian(state.mean.where(torch.arange(len(state.mean))[:, None] != 2, torch.inf), state.covariance)


def _raising(state: Gaussian) -> Gaussian:
    raise RuntimeError("of its own")


@pytest.mark.parametrize(
    ("changed", "fault", "least"),
    [
        (_negative, "update not positive semi-definite", 1),
        (_lopsided, "update not symmetric", 1),
        (_lost, "update not finite", 1),
        (_raising, "RuntimeError: of its own", 1),
    ],
)
def test_what_is_wrong_is_counted(
    changed: Callable[[Gaussian], Gaussian], fault: str, least: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(filters, "KINDS", {"wrong": partial(_but, changed)})
    found = soak_filters(SoakSettings(steps=16, filters=8))
    for dtype in ("float32", "float64"):
        assert found.faults[f"wrong, {dtype}: {fault}"] >= least


def test_the_input_is_hostile() -> None:
    """Measurements that are infinite, NaN, missing and far off; beliefs that are singular; gaps."""
    world = Hostile(400, MotionModel(), torch.float64, torch.Generator().manual_seed(0))
    seen = [world.measure() for _ in range(20)]
    values = torch.stack([one.value for one in seen])
    valid = torch.stack([one.valid for one in seen if one.valid is not None])
    assert bool((values == torch.inf).any() & (values == -torch.inf).any() & values.isnan().any())
    assert float(values[values.isfinite()].abs().max()) > 1e200
    assert 0.05 < float((~valid).double().mean()) < 0.5
    assert bool((~valid).all(-1).all(0).any()), "a gap of 20 frames"
    begun = world.begin()
    ranks = torch.linalg.matrix_rank(begun.covariance, rtol=1e-9)
    assert int(ranks.min()) == 0
    assert begun.mean.shape == (400, 3 * DOFS)


@pytest.mark.parametrize(("name", "value"), [("steps", 0), ("filters", 0)])
def test_settings_that_are_refused(name: str, value: int) -> None:
    with pytest.raises(ValueError, match=f"{name}: expected 1 or more, got {value}"):
        SoakSettings(**{name: value})
