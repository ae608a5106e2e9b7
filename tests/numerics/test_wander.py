"""The curves that motion scripts are made of."""

import pytest
import torch

from torchhand.numerics.wander import bump, ease, wander


def _curves(frames: int, pace: float = 1.0, seed: int = 3) -> torch.Tensor:
    seconds = torch.arange(frames, dtype=torch.float64) / 30
    return wander(seconds, 20, torch.Generator().manual_seed(seed), pace=pace)


def test_curves_stay_within_one_and_use_the_room() -> None:
    curves = _curves(3000)
    assert curves.abs().max() <= 1
    assert (curves.abs().amax(0) > 0.4).all()


def test_curves_start_from_rest_and_are_smooth() -> None:
    curves = _curves(600)
    assert (curves[0] == 0).all()
    speed = curves.diff(dim=0) * 30
    assert speed[0].abs().max() < 0.05 * speed.abs().max()
    # Sinusoids of at most 0.5 Hz, set in motion within half a second: no more than a few units per second squared.
    assert (curves.diff(n=2, dim=0) * 900).abs().max() < 40


def test_a_longer_sequence_begins_with_the_shorter_one() -> None:
    torch.testing.assert_close(_curves(200)[:50], _curves(50), rtol=0, atol=0)


def test_pace_is_the_speed_of_time() -> None:
    torch.testing.assert_close(_curves(100, pace=2.0)[:50], _curves(100)[::2], rtol=1e-12, atol=1e-12)
    assert (_curves(30, pace=0.0) == 0).all()


def test_seeds_differ() -> None:
    assert (_curves(90, seed=1) - _curves(90, seed=2)).abs().max() > 0.1


def test_ease_and_bump() -> None:
    x = torch.linspace(-0.5, 1.5, 2001, dtype=torch.float64)
    eased = ease(x)
    assert (eased.diff() >= 0).all()
    assert float(ease(torch.tensor(0.5))) == pytest.approx(0.5)
    assert (eased[x <= 0] == 0).all()
    torch.testing.assert_close(eased[x >= 1], torch.ones_like(eased[x >= 1]), rtol=1e-12, atol=0)
    assert eased.diff(n=2).abs().max() < 1e-5  # no corner anywhere
    bumped = bump(x)
    torch.testing.assert_close(bumped, bump(1 - x), rtol=0, atol=1e-12)
    assert float(bump(torch.tensor(0.5))) == pytest.approx(1.0)
    assert bumped[(x <= 0) | (x >= 1)].abs().max() < 1e-12
