"""The likelihood ratio of right hands to others: what it is made of, and how often it is wrong."""

from typing import Any

import pytest
import torch

from torchhand.study.status import KINDS, Sample, collect, derived_table
from torchhand.track import TrackerSettings
from torchhand.track.scene import Health

pytestmark = pytest.mark.slow  # collecting the samples takes a quarter of a minute
PLANAR = TrackerSettings()


@pytest.fixture(scope="module")
def samples() -> list[Sample]:
    return list(collect(PLANAR, 36, seed=1))


@pytest.fixture(scope="module")
def table(samples: list[Sample]) -> dict[str, Any]:
    return derived_table(samples, Health(settings=PLANAR.health))


def test_every_kind_of_scene_is_seen(samples: list[Sample]) -> None:
    counts = {kind: sum(sample.kind == kind for sample in samples) for kind in KINDS}
    assert min(counts.values()) >= 12, counts


def test_the_same_seed_gives_the_same_candidates(samples: list[Sample]) -> None:
    for one, other in zip(collect(PLANAR, 2, seed=1), samples, strict=False):
        assert one.kind == other.kind
        assert torch.equal(one.candidate.pose.dofs, other.candidate.pose.dofs)


def test_a_device_gives_the_candidates_of_the_processor(samples: list[Sample], device: torch.device) -> None:
    found = list(collect(PLANAR, 1, seed=1, device=device))
    assert found
    for one, other in zip(found, samples, strict=False):
        assert one.kind == other.kind
        torch.testing.assert_close(one.candidate.pose.dofs, other.candidate.pose.dofs, atol=1e-4, rtol=1e-3)


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
