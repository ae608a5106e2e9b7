"""`torchhand study ueda`: small runs end to end, stopped and resumed, and one line where it cannot be."""

import csv
import json
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from torchhand.cli.simulate import main as simulate
from torchhand.cli.studies import ueda
from torchhand.cli.studies.ueda import numbers_of
from torchhand.cli.study import main
from torchhand.errors import InputError
from torchhand.files import save_cameras
from torchhand.simulate import named_rig
from torchhand.study.ueda import STAGES, comparison_rows

SMALL = ("--levels", "6", "--iterations", "4", "--people", "1", "--cameras", "2", "--level", "5")


def table(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, ...]]:
    """Options of a study of small pictures."""
    rig = tmp_path_factory.mktemp("rig") / "cameras.json"
    save_cameras(named_rig("frame3", size=(160, 120)), rig)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ueda, "_REPEATS", 1)
        yield (*SMALL, "--rig", str(rig))


@pytest.fixture(scope="module")
def result(small: tuple[str, ...], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("study") / "out"
    assert main(["ueda", "--out", str(out), *small]) == 0
    return out


def test_tables_and_plots(result: Path) -> None:
    assert sorted(path.name for path in result.iterdir()) == [
        "comparison.csv",
        "comparison.png",
        "convergence.csv",
        "figure13.png",
        "figure14.png",
        "parts.json",
        "stages.csv",
    ]
    rows = table(result / "convergence.csv")
    assert [row["iteration"] for row in rows if row["steps"] == "largest"] == list("01234")
    assert {row["steps"] for row in rows} == {"largest", "proportional", "equal"}
    assert float(rows[0]["error_deg"]) == 10
    assert float(rows[4]["error_deg"]) < 10
    assert 0.5 < float(rows[0]["within_fraction"]) < float(rows[0]["inside_fraction"]) <= 1
    assert [row["stage"] for row in table(result / "stages.csv")] == list(STAGES)
    compared = table(result / "comparison.csv")
    assert {row["method"] for row in compared} == set(ueda.METHODS)
    assert {row["cameras"] for row in compared} == {"2"}
    for name in ("figure13", "figure14", "comparison"):
        picture = cv2.imread(str(result / f"{name}.png"))
        assert picture is not None
        assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 5


def test_a_stopped_study_goes_on_to_the_same_figures(
    result: Path,
    small: tuple[str, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    compared = ueda.fit_errors

    def stopped(*args: object) -> None:
        raise KeyboardInterrupt

    out = tmp_path / "out"
    monkeypatch.setattr(ueda, "fit_errors", stopped)
    assert main(["ueda", "--out", str(out), *small]) == 130
    assert "stopped by Ctrl-C; the same command with --resume goes on" in capsys.readouterr().err
    assert not (out / "comparison.csv").exists()
    monkeypatch.setattr(ueda, "fit_errors", compared)
    monkeypatch.setattr(ueda, "converge", stopped)  # what is done is not done again
    assert main(["ueda", "--out", str(out), *small, "--resume"]) == 0
    assert (out / "convergence.csv").read_bytes() == (result / "convergence.csv").read_bytes()
    for row, other in zip(table(out / "comparison.csv"), table(result / "comparison.csv"), strict=True):
        for name in ("method", "cameras", "people", "joint_mm_median", "flexion_deg_worst"):
            assert row[name] == other[name]
    assert main(["ueda", "--out", str(out), *small, "--seed", "1", "--resume"]) == 2
    assert "cannot be resumed: seed was 0, is now 1" in capsys.readouterr().err


def test_rows_are_medians_and_worst_over_people() -> None:
    def part(person: int, cameras: int, mm: float) -> dict[str, object]:
        errors = {"LM": {"joint_mm": mm, "flexion_deg": 2 * mm, "milliseconds": 5.0}}
        return {"kind": "compare", "person": person, "cameras": cameras, "errors": errors}

    parts = {f"{i}": part(i, cameras, mm) for i, (cameras, mm) in enumerate(((4, 1.0), (2, 8.0), (4, 2.0), (4, 6.0)))}
    two, four = comparison_rows(parts)
    assert (two["cameras"], two["people"], two["joint_mm_median"]) == (2, 1, 8.0)
    assert (four["people"], four["joint_mm_median"], four["joint_mm_worst"]) == (3, 2.0, 6.0)
    assert (four["flexion_deg_median"], four["flexion_deg_worst"]) == (4.0, 12.0)


@pytest.mark.slow
def test_another_makers_recording(tmp_path: Path) -> None:
    poses = ("--pose", "flat", "--pose", "flat,index_mcp_fe=10", "--background", "blue", "--view", "palm")
    assert simulate(["--out", str(tmp_path / "rig"), "--rig", "frame", "--random-hand", *poses]) == 0
    order = ["--levels", "7", "--people", "0", "--data", str(tmp_path / "rig")]
    assert main(["ueda", "--out", str(tmp_path / "out"), *order]) == 0
    rows = [row for row in table(tmp_path / "out" / "convergence.csv") if row["source"] == "data"]
    ends = {row["steps"]: float(row["error_deg"]) for row in rows}
    assert ends["largest"] < 4
    assert json.loads((tmp_path / "out" / "parts.json").read_text())["header"]["data"] == str(tmp_path / "rig")


def test_numbers() -> None:
    assert numbers_of("8, 1-3,2", "--cameras", 1, 8) == (1, 2, 3, 8)
    for text in ("", "0", "9", "3-1", "2-9", "two", "1,,2", "-1"):
        with pytest.raises(InputError, match="--cameras: expected numbers from 1 to 8, such as 1,2-8; got"):
            numbers_of(text, "--cameras", 1, 8)


@pytest.mark.parametrize(
    ("order", "message"),
    [
        (["--levels", "12"], "--levels: expected numbers from 3 to 9"),
        (["--cameras", "0-2"], "--cameras: expected numbers from 1 to 8"),
        (["--rig", "desk"], "--rig: expected a file or folder of cameras, frame1"),
        (["--angle-deg", "90"], "--angle-deg: expected 0 to 80, got 90"),
        (["--people", "-1"], "--people: expected 0 to 1000, got -1"),
        (["--iterations", "0"], "--iterations: expected 1 to 1000, got 0"),
        (["--threads", "0"], "--threads: expected 1 to 1024, got 0"),
        (["--resume", "--overwrite"], "at most one of --resume and --overwrite"),
        (["--data", "{tmp}/gone"], "gone: no such file or folder"),
        (["--data", "{tmp}/bare"], "bare/truth.npz: expected a folder with truth.npz"),
        (["--data", "{tmp}/single"], "single: expected two cameras or more, got 1"),
        (["--data", "{tmp}/flat"], "expected keypoints3d, which tell how far the finger is bent"),
        (["--data", "{tmp}/short", "--data-frames", "0", "3"], "--data-frames: expected frames 0 to 2 of"),
        (["--data", "{tmp}/short"], "short: no pictures of any camera"),
    ],
)
def test_wrong_orders_are_one_line_and_two(
    order: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cameras = named_rig("frame2", size=(64, 48))
    for name, some in (("bare", cameras), ("single", cameras[:1]), ("flat", cameras), ("short", cameras)):
        (tmp_path / name).mkdir()
        save_cameras(some, tmp_path / name / "cameras.json")
    np.savez(tmp_path / "single" / "truth.npz", keypoints3d=np.zeros((3, 21, 3)))
    np.savez(tmp_path / "flat" / "truth.npz", keypoints2d=np.zeros((3, 21, 2)))
    points = np.zeros((3, 21, 3))
    points[:, 1:, 1] = 0.09  # a palm's length from the wrist
    np.savez(tmp_path / "short" / "truth.npz", keypoints3d=points)
    order = [word.replace("{tmp}", str(tmp_path)) for word in order]
    assert main(["ueda", "--out", str(tmp_path / "out"), "--people", "0", *order]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("torchhand study: error: ")
    assert message in printed.err
    assert printed.err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_help_names_both_studies(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ueda", "--help"]) == 0
    assert "torchhand study ueda --out" in capsys.readouterr().out
    assert main(["--help"]) == 0
    assert "torchhand study ueda --help" in capsys.readouterr().out
