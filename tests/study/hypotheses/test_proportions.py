"""Intervals against scipy and their equation, the best of several tries against all choices, and quantiles."""

import itertools
import math

import numpy as np
import pytest
from scipy.stats import binomtest

from torchhand.study.hypotheses.proportions import (
    Z_95,
    quantile_with_failures,
    rank_weights,
    success_of_best,
    wilson_interval,
)


@pytest.mark.parametrize(("successes", "trials"), [(0, 7), (7, 7), (1, 30), (853, 1000), (1, 1)])
def test_wilson_as_scipy_has_it(successes: int, trials: int) -> None:
    expected = binomtest(successes, trials).proportion_ci(method="wilson")
    assert wilson_interval(successes, trials) == pytest.approx((expected.low, expected.high), abs=1e-12)


def test_wilson_ends_are_where_the_score_test_is_on_the_brink() -> None:
    for z in (1.0, Z_95, 3.0):
        for end in wilson_interval(83, 100, z):
            assert (end - 0.83) ** 2 == pytest.approx(z * z * end * (1 - end) / 100, rel=1e-12)


def test_nothing_tried_tells_nothing() -> None:
    assert wilson_interval(0, 0) == (0.0, 1.0)
    with pytest.raises(ValueError, match="successes: expected 0 to 3, got 4"):
        wilson_interval(4, 3)


@pytest.mark.parametrize("tries", [1, 2, 5, 8])
def test_best_of_several_is_the_mean_over_all_choices(tries: int) -> None:
    chance = np.random.default_rng(tries)
    misfit, is_success = chance.normal(size=8), chance.random(8) < 0.5
    misfit[3] = np.inf
    is_success[3] = False
    choices = [list(chosen) for chosen in itertools.combinations(range(8), tries)]
    brute = np.mean([is_success[chosen[int(np.argmin(misfit[chosen]))]] for chosen in choices])
    assert success_of_best(misfit, is_success, tries) == pytest.approx(brute, abs=1e-12)


@pytest.mark.parametrize(("count", "tries"), [(1, 1), (6, 1), (6, 4), (6, 6), (5000, 16)])
def test_ranks_are_weighed_by_binomials(count: int, tries: int) -> None:
    expected = [math.comb(count - 1 - rank, tries - 1) / math.comb(count, tries) for rank in range(count)]
    np.testing.assert_allclose(rank_weights(count, tries), expected, rtol=1e-9, atol=1e-300)


def test_more_tries_than_starts_are_unknown() -> None:
    assert math.isnan(success_of_best(np.zeros(3), np.ones(3, dtype=bool), 4))
    with pytest.raises(ValueError, match="tries: expected 1 to 3, got 4"):
        rank_weights(3, 4)


def test_quantiles_are_values_that_occur_and_failures_are_infinite() -> None:
    chance = np.random.default_rng(0)
    values = chance.normal(size=101)
    for fraction in (0.01, 0.5, 0.9, 1.0):
        assert quantile_with_failures(values, fraction) == np.quantile(values, fraction, method="inverted_cdf")
    values = np.array([3.0, np.nan, 1.0, 2.0])
    assert quantile_with_failures(values, 0.5) == 2.0
    assert quantile_with_failures(values, 0.75) == 3.0
    assert quantile_with_failures(values, 0.9) == math.inf
    assert math.isnan(quantile_with_failures(np.empty(0), 0.5))
    with pytest.raises(ValueError, match="fraction: expected above 0, to 1, got 0"):
        quantile_with_failures(values, 0.0)
