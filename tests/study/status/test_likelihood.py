"""The likelihood ratio of right hands to others."""

import itertools
import math
from statistics import NormalDist

import pytest

from torchhand.study.status.likelihood import EVIDENCE, EvidenceDensity, LikelihoodRatio


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


@pytest.mark.parametrize("column", range(len(EVIDENCE)))
def test_better_overlap_and_edges_are_never_worse(column: int) -> None:
    known = ratio()
    mean, sign = known.right.mean, -1.0 if EVIDENCE[column] == "beyond" else 1.0
    below = [0.1 * step for step in range(-40, 20)]
    rows = [tuple(m + sign * d * (i == column) for i, m in enumerate(mean)) for d in below]
    nats = [known.nats(row) for row in rows]
    assert all(b >= a - 0.05 for a, b in itertools.pairwise(nats))  # densities are fitted: flat at the top
