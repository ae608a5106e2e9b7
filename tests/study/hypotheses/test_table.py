"""The table of a hypothesis study, from hypotheses made by hand."""

import csv
import io
import math

import numpy as np
import pytest

from torchhand.study import PerturbationSettings
from torchhand.study.hypotheses.proportions import success_of_best, wilson_interval
from torchhand.study.hypotheses.record import STATUS_NAMES, Hypotheses
from torchhand.study.hypotheses.settings import HypothesisStudySettings
from torchhand.study.hypotheses.table import csv_text, printed_table, study_rows

SETTINGS = HypothesisStudySettings(
    perturbation=PerturbationSettings(angle_deg=10.0, translation_mm=8.0, rotation_deg=6.0, levels=2),
    best_of=(1, 2, 3, 30),
)


def hypotheses(count: int = 40, frames: int = 2) -> Hypotheses:
    """Of every frame and level the same number; the first three of all have failed."""
    chance = np.random.default_rng(1)
    index = np.arange(count)
    failed = index < 3

    def known(values: np.ndarray) -> np.ndarray:
        return np.where(failed, np.nan, values)

    return Hypotheses(
        frame=7 + index % frames,
        batch=index // 8,
        seed=index // 8 + 100,
        level=index // frames % 2 + 1,
        perturbation=chance.normal(size=(count, 26)),
        start_angle_deg=chance.uniform(0, 10, count),
        start_keypoint_mm=chance.uniform(0, 20, count),
        start_rotation_deg=chance.uniform(0, 10, count),
        angle_deg=known(chance.uniform(0, 10, count)),
        keypoint_mm=known(chance.uniform(0, 20, count)),
        rotation_deg=known(chance.uniform(0, 10, count)),
        contour_px=known(chance.uniform(0, 2, count)),
        cost=np.where(failed, np.inf, chance.uniform(0, 100, count)),
        misfit=np.where(failed, np.inf, chance.uniform(0, 100, count)),
        status=np.where(failed, 2, index % 2),
        iterations=np.full(count, 9),
        pose=np.where(failed[:, None], np.nan, chance.normal(size=(count, 36))),
    )


def test_rows_are_of_their_own_starts() -> None:
    made = hypotheses()
    rows = study_rows(made, SETTINGS)
    assert [(row.frame, row.size) for row in rows] == [
        *(("all", 0.5), ("all", 1.0)),
        *(("7", 0.5), ("7", 1.0), ("8", 0.5), ("8", 1.0)),
    ]
    row = rows[1]
    own = made.select(made.level == 2)
    assert (row.angle_deg, row.translation_mm, row.rotation_deg, row.starts) == (10, 8, 6, 20)
    succeeded = int((own.angle_deg <= 5).sum())
    assert row.success == succeeded / 20
    assert (row.success_low, row.success_high) == wilson_interval(succeeded, 20)
    assert row.start_success == float((own.start_angle_deg <= 5).mean())
    ordered = np.sort(np.nan_to_num(own.keypoint_mm, nan=math.inf))
    assert (row.keypoint_median_mm, row.keypoint_p90_mm) == (ordered[9], ordered[17])
    assert sum(row.statuses) == pytest.approx(1)
    assert row.failed == row.statuses[2] == float((own.status == 2).mean()) > 0


def test_failures_are_no_successes_and_count_in_the_quantiles() -> None:
    made = hypotheses(8, 1)  # of the four of level 1, the first and the third have failed
    row = study_rows(made, SETTINGS)[0]
    assert row.failed == 0.5
    assert row.angle_median_deg < math.inf
    assert row.angle_p90_deg == math.inf
    assert row.success <= 0.5


def test_misfits_of_different_pictures_are_not_compared() -> None:
    made = hypotheses()
    row = study_rows(made, SETTINGS)[0]
    shift = np.where(made.frame == 7, 1e6, 0.0)
    arrays = made.arrays() | {"misfit": made.misfit + shift}
    assert study_rows(Hypotheses.from_arrays(arrays), SETTINGS)[0].best_of[:3] == row.best_of[:3]
    own = [made.select((made.level == 1) & (made.frame == frame)) for frame in (7, 8)]
    expected = [success_of_best(one.misfit, one.is_success(5.0), 3) for one in own]
    assert row.best_of[2] == pytest.approx(np.mean(expected))
    assert row.best_of[0] == pytest.approx(row.success)
    assert math.isnan(row.best_of[3])


def test_one_frame_needs_no_rows_of_its_own() -> None:
    assert [row.frame for row in study_rows(hypotheses(frames=1), SETTINGS)] == ["all", "all"]


def test_the_file_holds_what_the_rows_do() -> None:
    rows = study_rows(hypotheses(), SETTINGS)
    read = list(csv.DictReader(io.StringIO(csv_text(rows, SETTINGS))))
    assert [line["frame"] for line in read] == [row.frame for row in rows]
    for line, row in zip(read, rows, strict=True):
        assert float(line["success"]) == pytest.approx(row.success, rel=1e-5)
        assert [float(line[name]) for name in STATUS_NAMES] == pytest.approx(row.statuses, rel=1e-5)
        best = [float(line[f"best_of_{tries}"]) for tries in SETTINGS.best_of]
        assert best == pytest.approx(row.best_of, rel=1e-5, nan_ok=True)


def test_the_terminal_gets_a_line_per_size() -> None:
    rows = study_rows(hypotheses(), SETTINGS)
    lines = printed_table(rows, SETTINGS).splitlines()
    assert len(lines) == 4
    assert lines[3].startswith("±10° ±8 mm ±6°")
    assert f"{rows[1].success:.1%}" in lines[3]
    assert len({len(line.split("°, ")[0]) for line in lines[2:]}) == 1  # columns stand below each other


def test_arrays_of_differing_lengths_are_no_hypotheses() -> None:
    arrays = hypotheses().arrays() | {"misfit": np.zeros(3)}
    with pytest.raises(ValueError, match=r"expected arrays of one length, got \[3, 40\]"):
        Hypotheses.from_arrays(arrays)
