"""`torchhand learn_pose --pictures`: a tiny training from pictures, broken off and taken up again, and refused."""

import csv
import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.learn.pictures.conftest import SMALL, Recording
from tests.learn.pictures.conftest import recording as recording
from torchhand.cli.learn_pose import main
from torchhand.cli.learning import from_pictures
from torchhand.files import load_hand_model
from torchhand.learn.pictures import Teacher, load_picture_record, recorded_crops, recorded_figures


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the command line does not offer: a smaller network, fewer steps, reports at each few."""
    monkeypatch.setattr(from_pictures, "PictureTraining", lambda: SMALL)
    monkeypatch.setattr(from_pictures, "_MIN_STEPS", 3)


def order(recording: Recording, out: Path, *more: str) -> list[str]:
    files = ["--video", str(recording.pictures), "--keypoints", str(recording.points)]
    return ["--pictures", "--out", str(out), *files, "--frames", "0", "4", "--judge", "5", "7", *more]


@pytest.mark.slow
def test_a_training_that_is_broken_off_twice_ends_in_the_same_bytes(
    recording: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Among the steps on the simulator and among those on the recording; what is measured is what was asked for."""
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    assert main(order(recording, whole)) == 0
    assert "overlap with the silhouette" in capsys.readouterr().out
    draw, stopped = from_pictures._draw, []

    def draw_and_stop(out: Path, curve: list) -> None:
        draw(out, curve)
        if curve[-1]["step"] in (3, 6):
            stopped.append(curve[-1]["step"])
            raise KeyboardInterrupt

    monkeypatch.setattr(from_pictures, "_draw", draw_and_stop)
    assert main(order(recording, broken)) == 130
    assert main(["--pictures", "--out", str(broken), "--resume"]) == 130
    assert stopped == [3, 6]
    assert main(["--pictures", "--out", str(broken), "--resume"]) == 0
    for name in ("curve.csv", "curve.png", "figures.json", "log.jsonl"):
        assert (whole / name).read_bytes() == (broken / name).read_bytes(), name
    one, other = (load_picture_record(folder).kept["network"] for folder in (whole, broken))
    assert all(torch.equal(one[name], other[name]) for name in one)
    rows = [json.loads(line) for line in (whole / "log.jsonl").read_text().splitlines()]
    assert [row["step"] for row in rows] == [3, 4, 6, 8]
    with (whole / "curve.csv").open() as file:
        assert [int(row["step"]) for row in csv.DictReader(file)] == [3, 4, 6, 8]
    figures = json.loads((whole / "figures.json").read_text())
    assert figures["simulator"] == rows[1]
    assert figures["recording"] == rows[-1]
    assert 0 <= rows[-1]["judge/overlap"] <= 1
    record, crops = load_picture_record(whole), recorded_crops(recording.pictures, recording.points, range(5, 8))
    teacher, network = Teacher(load_hand_model()), record.network(load_hand_model())
    assert recorded_figures(network, crops, teacher)["points_px"] == pytest.approx(
        rows[-1]["judge/points_px"], rel=1e-6
    )
    assert (whole / "events").is_dir() == (importlib.util.find_spec("tensorboard") is not None)
    assert main(["--pictures", "--out", str(broken), "--resume", "--frames", "0", "3"]) == 2
    assert "--frames: expected (0, 4), as " in capsys.readouterr().err


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--pictures", "--video", "a.mp4"], "--video and --keypoints: expected both or none, got one"),
        (["--pictures", "--judge", "0", "5"], "--judge: expected with --video alone; got it without one"),
        (["--video", "a.mp4"], "--video, --keypoints, --judge: expected with --pictures alone"),
        (["--pictures", "--pool", "2"], "--pool: expected 8 to 10000000, got 2"),
        (["--pictures", "--resume"], "out: expected a folder with model.pt of an earlier training; there is none"),
        (["--pictures", "--video", "{tmp}/no.mp4", "--keypoints", "{tmp}/points.npz"], "no.mp4"),
        (["--pictures", "--evaluate", "{tmp}"], "expected a folder with truth.npz; there is none"),
    ],
)
def test_wrong_orders_are_one_line_and_two(
    more: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    np.savez(tmp_path / "points.npz", points_px=np.ones((2, 21, 2)), label=np.array(["Left", "Left"]))
    more = [word.replace("{tmp}", str(tmp_path)) for word in more]
    assert main(["--out", str(tmp_path / "out"), *more]) == 2
    printed = capsys.readouterr()
    assert printed.err.startswith("torchhand learn_pose: error: ")
    assert message in printed.err
    assert printed.err.count("\n") == 1


def test_models_of_the_other_kind_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "model.pt").write_bytes(b"PK something else")
    assert main(["--pictures", "--out", str(tmp_path), "--resume"]) == 2
    assert "expected a network saved by learn_pose --pictures" in capsys.readouterr().err
