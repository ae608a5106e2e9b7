"""`torchhand measure_detector`: the table that comes with the package, and what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest

from torchhand.cli.measure_detector import _TABLE as TABLE
from torchhand.cli.measure_detector import main
from torchhand.hand import JOINT_DOFS, KEYPOINTS


def test_the_table_of_the_package_tells_how_it_was_made_and_holds_for_recordings_that_are_not_in_it() -> None:
    table = json.loads(TABLE.read_text(encoding="utf-8"))
    assert table["command"].split()[:2] == ["torchhand", "measure_detector"]
    assert list(table["points"]) == list(KEYPOINTS)
    assert set(table["angles"]) < set(JOINT_DOFS)
    angles = [one["angles"] for one in table["held_out"].values()]
    assert 0.8 < float(np.sqrt(np.mean(np.square(angles)))) < 1.4  # 1 is what the standard deviations promise
    assert max(angles) < 2.0


def test_it_is_made_from_folders_of_truth_and_detections(data_dir: Path, tmp_path: Path) -> None:
    out, names = tmp_path / "errors.json", ("rom_palm", "flexion", "abduction28")
    assert main([*(str(data_dir / "synthetic" / name) for name in names), "--out", str(out)]) == 0
    made, shipped = (json.loads(path.read_text(encoding="utf-8")) for path in (out, TABLE))
    assert made["command"] == "torchhand measure_detector rom_palm flexion abduction28"
    assert {name: one["frames"] for name, one in made["held_out"].items()} == {
        name: shipped["held_out"][name]["frames"] for name in names
    }


def test_too_few_recordings_and_folders_without_truth_are_errors_of_the_user(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([str(tmp_path), "--out", str(tmp_path / "out.json")]) == 2
    assert "truth.npz" in capsys.readouterr().err
    assert not (tmp_path / "out.json").exists()
