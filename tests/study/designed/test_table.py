"""The table counts trials, and of each trial the start that explains the observations best."""

from dataclasses import fields

import numpy as np
import pytest

from torchhand.fit import SolveStatus
from torchhand.study.designed.study import Study
from torchhand.study.designed.table import best_of_trials, cell_rows, csv_text, printed_table
from torchhand.study.hypotheses import Hypotheses

STUDY = Study(factors={"hypotheses": [1, 3], "noise": [2.0]}, trials=4, pictures=2)


def made(angle_deg: list[float], misfit: list[float], batch: list[int]) -> Hypotheses:
    """Starts with these errors; infinite misfits are failures."""
    count, values = len(angle_deg), np.array(angle_deg)
    plain = {f.name: np.zeros(count) for f in fields(Hypotheses)}
    failed = np.isinf(misfit)
    status = np.where(failed, SolveStatus.FAILED.value, SolveStatus.CONVERGED.value)
    numbers = {name: np.zeros(count, dtype=np.int64) for name in ("frame", "seed", "level", "iterations")}
    wide = {"perturbation": np.zeros((count, 26)), "pose": np.zeros((count, 36))}
    own = {"angle_deg": np.where(failed, np.nan, values), "misfit": np.array(misfit), "batch": np.array(batch)}
    return Hypotheses(**(plain | numbers | wide | own | {"status": status}))


def test_rows_count_the_best_start_of_each_trial() -> None:
    one = made([1.0, 9.0, 2.0, 3.0], [5.0, 1.0, 1.0, np.inf], [0, 0, 1, 1])
    several = made([9.0, 1.0, 7.0] * 4, [3.0, 1.0, 2.0, 1.0, 2.0, 3.0] * 2, [2] * 6 + [3] * 6)
    both = Hypotheses.joined((one, several), 16)
    first, second = cell_rows(STUDY, both)
    assert (first.trials, first.successes, second.trials, second.successes) == (4, 2, 4, 2)
    assert first.converged == 0.75
    # Wilson's interval of 2 of 4, by its closed form
    z2 = 1.959963984540054**2
    half = (z2 * (0.25 / 4 + z2 / 64)) ** 0.5 / (1 + z2 / 4)
    assert (first.success_low, first.success_high) == pytest.approx((0.5 - half, 0.5 + half), abs=1e-12)
    assert first.angle_p90_deg == np.inf
    lines = csv_text(STUDY, [first, second]).splitlines()
    assert lines[0].startswith("cell,hypotheses,noise,trials,successes,success,")
    assert lines[2].startswith("1,3,2,4,2,0.5,")
    assert "50.0% (15.0% to 85.0%)" in printed_table(STUDY, [first, second])


def test_the_best_of_some_is_chosen_by_misfit_alone() -> None:
    found = best_of_trials(made([1.0, 2.0, 3.0, 4.0], [2.0, 1.0, np.inf, 9.0], [0, 0, 0, 0]), 2)
    assert found.angle_deg.tolist() == [2.0, 4.0]
