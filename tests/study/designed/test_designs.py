"""Designs hold what their names promise: all combinations, one change at a time, every stratum once."""

from collections import Counter

import numpy as np
import pytest

from torchhand.study.designed.designs import Between, Full, LatinHypercube, OneAtATime, design_of

FACTORS = {"a": [1, 2, 3], "b": ["x", "y"], "c": [0.0, 0.5]}


def test_a_full_design_has_every_combination_once() -> None:
    cells = Full().cells(FACTORS, None, 0)
    assert len(cells) == 12
    assert len({tuple(cell.items()) for cell in cells}) == 12


def test_one_at_a_time_changes_one_factor_in_every_level_of_the_crossed_one() -> None:
    cells = OneAtATime().cells(FACTORS, "b", 0)
    plain = {"a": 1, "c": 0.0}
    changes = [{name for name in plain if cell[name] != plain[name]} for cell in cells]
    assert max(map(len, changes)) == 1
    assert Counter(cell["b"] for cell in cells) == {"x": 4, "y": 4}
    assert {(cell["a"], cell["c"]) for cell in cells} == {(1, 0.0), (2, 0.0), (3, 0.0), (1, 0.5)}


def test_a_latin_hypercube_has_one_cell_in_every_stratum() -> None:
    """And as many of every level as the levels allow; the same again from the same seed."""
    count = 12
    factors = {"x": Between(-1.0, 3.0), "y": Between(10.0, 20.0), **FACTORS}
    cells = LatinHypercube(count).cells(factors, "b", 5)
    own = [cell for cell in cells if cell["b"] == "x"]
    assert len(cells) == 2 * count
    for name, (low, high) in {"x": (-1.0, 3.0), "y": (10.0, 20.0)}.items():
        strata = np.floor((np.array([cell[name] for cell in own]) - low) / (high - low) * count)
        assert sorted(strata.tolist()) == list(range(count))
    assert Counter(cell["a"] for cell in own) == {1: 4, 2: 4, 3: 4}
    assert cells == LatinHypercube(count).cells(factors, "b", 5)
    assert cells != LatinHypercube(count).cells(factors, "b", 6)


def test_a_range_has_no_levels() -> None:
    with pytest.raises(ValueError, match=r"x: expected levels: only a Latin hypercube draws from between two"):
        Full().cells({"x": Between(0, 1)}, None, 0)


def test_designs_have_names() -> None:
    assert design_of({"latin_hypercube": 8}) == LatinHypercube(8)
    assert design_of("one_at_a_time") == OneAtATime()
    with pytest.raises(ValueError, match="design: expected full, one_at_a_time or"):
        design_of("fractional")
