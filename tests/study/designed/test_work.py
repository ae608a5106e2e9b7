"""A designed study at work: the same bytes whatever interrupts it, and outcomes that follow the conditions."""

import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from torchhand.errors import InputError
from torchhand.study.designed import Study, run_study
from torchhand.study.designed.cell import CellRegistration
from torchhand.study.hypotheses import CSV_NAME, NPZ_NAME, PICTURE_NAME, Hypotheses, StudyBatch

NAMES = (CSV_NAME, NPZ_NAME, PICTURE_NAME)
STUDY = Study(
    factors={"observation": ["points"], "dropout": [0.0, 1.0]},
    fixed={"hypotheses": 2},
    trials=2,
    pictures=2,
)

pytest.importorskip("matplotlib", reason="the plot needs matplotlib (extra study)")


def content(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in NAMES}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole") / "study"
    run_study(STUDY, folder)
    return folder


def test_results_are_four_files_and_follow_the_conditions(whole: Path) -> None:
    """Points tell the hand; none of them do not, and the starts, however near, count for nothing then."""
    assert sorted(path.name for path in whole.iterdir()) == sorted(NAMES)
    with np.load(whole / NPZ_NAME) as found:
        assert found["cell"].tolist() == [0] * 4 + [1] * 4
        assert len(set(found["seed"].tolist())) == 4
        assert np.median(found["angle_deg"][:4]) < 5
        assert set(found["status"][4:].tolist()) == {"no_data"}
        assert not found["success"][4:].any()


def test_an_interrupted_study_goes_on_to_the_same_bytes(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done, plain = [], CellRegistration.__call__

    def interrupted(self: CellRegistration, batch: StudyBatch) -> Hypotheses:
        if len(done) == 2:
            raise KeyboardInterrupt
        done.append(batch)
        return plain(self, batch)

    monkeypatch.setattr(CellRegistration, "__call__", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run_study(STUDY, tmp_path / "study")
    monkeypatch.setattr(CellRegistration, "__call__", plain)
    other = Study(factors=STUDY.factors, fixed=STUDY.fixed, trials=2, pictures=2, seed=1)
    with pytest.raises(InputError, match=r"cannot be resumed: study\.seed was 0, is now 1"):
        run_study(other, tmp_path / "study", resume=True)
    run_study(STUDY, tmp_path / "study", workers=2, resume=True)
    assert content(tmp_path / "study") == content(whole)


def test_a_finished_study_is_read(whole: Path) -> None:
    found = run_study(STUDY, whole, resume=True)
    assert found.seconds == 0
    assert [row.trials for row in found.rows] == [2] * 2


def test_without_matplotlib_one_line_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(InputError, match=r"needs matplotlib: pip install 'torchhand\[study\]'"):
        run_study(STUDY, tmp_path / "study")
    assert not (tmp_path / "study").exists()


@pytest.mark.parametrize("observation", ["points", "all"])
def test_starts_are_registered_on_a_device(observation: str, device: torch.device) -> None:
    """The same pictures and starts as on the processor, and the same hands."""
    study = Study(factors={"observation": [observation]}, fixed={"hypotheses": 2, "cameras": 2}, trials=1, pictures=1)
    batch = StudyBatch(index=0, case=0, first=0, count=2)
    here, there = CellRegistration(study)(batch), CellRegistration(study, device)(batch)
    np.testing.assert_array_equal(there.perturbation, here.perturbation)
    np.testing.assert_allclose(there.start_angle_deg, here.start_angle_deg, atol=1e-9)
    np.testing.assert_allclose(there.angle_deg, here.angle_deg, atol=0.05)
    np.testing.assert_array_equal(there.status, here.status)
