"""The likelihood ratio of right hands to others: what it is made of, and how often it is wrong."""

from typing import Any

import pytest
import torch

from torchhand.study.status import KINDS, EvidenceDensity, Kind, Sample, collect, derived_table, log_likelihood_ratio
from torchhand.track import TrackerSettings
from torchhand.track.scene import Health

PLANAR = TrackerSettings()


@pytest.fixture(scope="module")
def samples() -> list[Sample]:
    return list(collect(PLANAR, 36, seed=1))


@pytest.fixture(scope="module")
def table(samples: list[Sample]) -> dict[str, Any]:
    return derived_table(samples, Health(settings=PLANAR.health))


def densities(**means: tuple[float, float, float]) -> dict[Kind, EvidenceDensity]:
    wide = {"right": 0.7, "wrong": 1.2, "none": 1.2}
    return {
        kind: EvidenceDensity(mean=torch.tensor(means[kind]).double(), std=torch.full((3,), wide[kind]).double())
        for kind in KINDS
    }


def test_better_evidence_is_never_worse() -> None:
    known = densities(right=(3.0, 3.0, -4.6), wrong=(-0.5, -1.0, -3.5), none=(1.0, 0.0, -4.0))
    steps = torch.linspace(-3.0, 4.0, 50, dtype=torch.float64)
    for column, sign in ((0, 1.0), (1, 1.0), (2, -1.0)):
        rows = torch.tensor((2.0, 2.0, -4.0)).double().expand(50, 3).clone()
        rows[:, column] = sign * steps if column < 2 else -4.0 + sign * steps
        assert bool((log_likelihood_ratio(rows, known).diff() >= -1e-12).all())


def test_the_ratio_is_that_of_the_densities() -> None:
    known = densities(right=(3.0, 3.0, -4.6), wrong=(0.0, 0.0, -4.0), none=(0.0, 0.0, -4.0))
    row = torch.tensor(((1.0, 0.5, -4.2),)).double()
    normals = {kind: torch.distributions.Normal(one.mean, one.std) for kind, one in known.items()}
    expected = normals["right"].log_prob(row).sum() - normals["wrong"].log_prob(row).sum()
    torch.testing.assert_close(log_likelihood_ratio(row, known)[0], expected, rtol=1e-12, atol=1e-12)


def test_every_kind_of_scene_is_seen(samples: list[Sample]) -> None:
    counts = {kind: sum(sample.kind == kind for sample in samples) for kind in KINDS}
    assert min(counts.values()) >= 12, counts


def test_the_same_seed_gives_the_same_candidates(samples: list[Sample]) -> None:
    for one, other in zip(collect(PLANAR, 2, seed=1), samples, strict=False):
        assert one.kind == other.kind
        assert torch.equal(one.candidate.pose.dofs, other.candidate.pose.dofs)


def test_stricter_rates_have_stricter_thresholds(table: dict[str, Any]) -> None:
    for kind, sign in (("found", -1), ("failing", 1)):
        nats = [sign * table[kind][rate]["nats"] for rate in sorted(table[kind], key=float)]
        assert nats == sorted(nats)


def test_a_right_hand_is_told_from_others_better_than_by_chance(table: dict[str, Any]) -> None:
    assert table["found"]["0.1"]["missed_right"] < 0.5
    assert table["failing"]["0.1"]["missed_wrong"] < 0.5
    assert table["failing"]["0.1"]["missed_none"] < 0.9


def test_too_few_pictures_are_refused(samples: list[Sample]) -> None:
    with pytest.raises(ValueError, match="or more of the kind"):
        derived_table(samples[:3], Health(settings=PLANAR.health))
