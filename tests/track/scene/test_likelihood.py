"""The likelihood ratio of right hands to others, and the test made of it."""

import itertools
import math
from statistics import NormalDist

import pytest

from torchhand.track.scene import EVIDENCE, EvidenceDensity, HandTest, LikelihoodRatio, measured_test

CONFIGS = ("contour_full", "contour_planar", "distance_full")


def ratio() -> LikelihoodRatio:
    other = EvidenceDensity(mean=(0.0, 0.5, -4.0), std=(1.2, 1.3, 1.0))
    return LikelihoodRatio(right=EvidenceDensity(mean=(3.0, 3.0, -4.6), std=(0.7,) * 3), wrong=other, none=other)


def test_the_ratio_is_that_of_the_densities() -> None:
    values, known = (1.0, 0.5, -4.2), ratio()
    right, wrong = (
        sum(math.log(NormalDist(mean, std).pdf(x)) for x, mean, std in zip(values, one.mean, one.std, strict=True))
        for one in (known.right, known.wrong)
    )
    assert known.nats(values) == pytest.approx(right - wrong, rel=1e-12)


@pytest.mark.parametrize("config", CONFIGS)
@pytest.mark.parametrize("column", range(len(EVIDENCE)))
def test_better_overlap_and_edges_are_never_worse(config: str, column: int) -> None:
    known = measured_test(config).ratio
    mean, sign = known.right.mean, -1.0 if EVIDENCE[column] == "beyond" else 1.0
    below = [0.1 * step for step in range(-40, 20)]
    rows = [tuple(m + sign * d * (i == column) for i, m in enumerate(mean)) for d in below]
    nats = [known.nats(row) for row in rows]
    assert all(b >= a - 0.05 for a, b in itertools.pairwise(nats))  # densities are fitted: flat at the top


@pytest.mark.parametrize("config", CONFIGS)
def test_fewer_false_alarms_ask_for_more(config: str) -> None:
    test = measured_test(config)
    nats = [test.threshold(rate) for rate in (0.01, 0.015, 0.02, 0.03, 0.05, 0.07, 0.1)]
    assert nats == sorted(nats, reverse=True)
    for rate, known in test.thresholds.items():
        assert test.threshold(rate) == pytest.approx(known, abs=1e-12)


@pytest.mark.parametrize("rate", [0.001, 0.5])
def test_rates_that_were_not_measured_are_refused(rate: float) -> None:
    test = HandTest(ratio=ratio(), thresholds={0.01: 3.0, 0.1: 0.0})
    with pytest.raises(ValueError, match=r"health\.false_alarm_rate: expected 0\.01 to 0\.1"):
        test.threshold(rate)
