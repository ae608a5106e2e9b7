"""`torchhand learn_pose`: a tiny training from the command line, taken up again, measured, and refused."""

import csv
import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from torchhand.cli import learn_pose
from torchhand.cli.learn_pose import main
from torchhand.files import load_hand_model
from torchhand.hand import HandPrior
from torchhand.learn import SampleSettings, draw_samples, hand_pool, load_record

SMALL = ("--steps", "50", "--pool", "100", "--batch", "16")
NAMES = ["curve.csv", "curve.png", "figures.json", "model.pt"]


@pytest.fixture(scope="module", autouse=True)
def few_hands() -> Iterator[None]:
    """What the command line does not offer: fewer hands to measure on, a smaller network, no energy."""
    small = learn_pose.TrainingSettings(held_out=60, width=16, blocks=1, energy_hands=0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(learn_pose, "TrainingSettings", lambda: small)
        yield


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a finished training; not to be changed."""
    out = tmp_path_factory.mktemp("trained") / "out"
    assert main(["--out", str(out), *SMALL]) == 0
    return out


@pytest.fixture
def finished(trained: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    return Path(shutil.copytree(trained, tmp_path / "finished"))


@pytest.fixture(scope="module")
def stills(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Right hands of the prior in one folder, their mirror images in another."""
    model, generator = load_hand_model(), torch.Generator().manual_seed(1)
    pool = hand_pool(HandPrior(model.skeleton, model.shape_space, dtype=torch.float64), model, 8, generator)
    points = draw_samples(pool, torch.arange(8), SampleSettings(), generator).keypoints.numpy()
    folder = tmp_path_factory.mktemp("stills")
    for side, sign in (("right", 1), ("left", -1)):
        (folder / side).mkdir()
        names = np.array([f"{i}.jpg" for i in range(8)])
        matrices = np.tile(np.diag([300.0, 300.0, 1.0]), (8, 1, 1))
        np.savez(folder / side / "truth.npz", image=names, K=matrices, keypoints3d=points * [sign, 1, 1])
    return folder


def _content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def test_a_training_leaves_its_results(trained: Path) -> None:
    assert sorted(path.name for path in trained.iterdir()) == NAMES
    with (trained / "curve.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["step"]) for row in rows] == [25, 50]
    assert float(rows[1]["loss"]) < float(rows[0]["loss"])
    figures = json.loads((trained / "figures.json").read_text())
    assert (figures["steps"], figures["settings"]["pool"], figures["settings"]["seed"]) == (50, 100, 0)
    assert figures["held_out"]["network"]["aligned_mm"] == pytest.approx(float(rows[-1]["aligned_mm"]), rel=1e-4)
    picture = cv2.imread(str(trained / "curve.png"))
    assert picture is not None
    assert picture.shape == (320, 3 * 480, 3)


def test_a_finished_training_is_only_measured(finished: Path, stills: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = _content(finished)
    assert main(["--out", str(finished), "--resume", "--steps", "50", "--evaluate", str(stills / "right")]) == 0
    after = _content(finished)
    assert all(before[name] == after[name] for name in ("curve.csv", "curve.png", "model.pt"))
    figures = json.loads(after["figures.json"])
    for where in ("held_out", "stills"):
        for whose in ("network", "baseline"):
            assert 1 < figures[where][whose]["flexion_deg"] < 60
            assert 1 < figures[where][whose]["root_relative_mm"] < 300
    printed = capsys.readouterr()
    assert printed.err == ""  # no progress bar where nobody watches
    assert f"{figures['stills']['network']['aligned_mm']:.1f}" in printed.out
    assert printed.out.endswith(f"saved model.pt, curve.csv, curve.png and figures.json in {finished}\n")


def test_left_hands_are_seen_in_the_mirror(finished: Path, stills: Path) -> None:
    figures = {}
    for side in ("right", "left"):
        order = ["--out", str(finished), "--resume", "--evaluate", str(stills / side), "--side", side]
        assert main(order) == 0
        figures[side] = json.loads((finished / "figures.json").read_text())["stills"]
    for whose in ("network", "baseline"):
        for name, value in figures["right"][whose].items():
            assert figures["left"][whose][name] == pytest.approx(value, rel=1e-3), name


def test_the_same_order_gives_the_same_bytes_and_an_interrupted_one_too(
    trained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    again, broken = tmp_path / "again", tmp_path / "broken"
    assert main(["--out", str(again), *SMALL]) == 0
    draw = learn_pose._draw

    def draw_and_stop(*arguments: object) -> None:
        draw(*arguments)  # type: ignore[arg-type]
        raise KeyboardInterrupt

    monkeypatch.setattr(learn_pose, "_draw", draw_and_stop)
    capsys.readouterr()
    assert main(["--out", str(broken), *SMALL]) == 130
    assert f"--resume goes on from {broken}" in capsys.readouterr().err
    assert load_record(broken).kept["step"] == 25
    monkeypatch.setattr(learn_pose, "_draw", draw)
    assert main(["--out", str(broken), "--resume"]) == 0
    for name in ("curve.csv", "curve.png", "figures.json"):
        assert (trained / name).read_bytes() == (again / name).read_bytes() == (broken / name).read_bytes(), name
    weights = [load_record(folder).kept["network"] for folder in (trained, again, broken)]
    for name, value in weights[0].items():
        assert all(torch.equal(value, other[name]) for other in weights[1:]), name


@pytest.mark.parametrize(
    ("order", "message"),
    [
        (["--steps", "0"], "--steps: expected 1 to 10000000, got 0"),
        (["--pool", "5"], "--pool: expected 10 to 10000000, got 5"),
        (["--seed", "-1"], "--seed: expected 0 to"),
        (["--batch", "1"], "--batch: expected 2 to 100000, got 1"),
        (["--resume"], "out: expected a folder with model.pt of an earlier training; there is none"),
        (["--resume", "--overwrite"], "expected at most one of --resume and --overwrite, got both"),
        (["--evaluate", "{tmp}/gone"], "gone: expected a folder with truth.npz; there is none"),
        (["--threads", "0"], "--threads: expected 1 to 1024, got 0"),
        (["--side", "both"], "--side: expected left or right, got 'both'"),
        (["--unknown", "1"], "--unknown"),
    ],
)
def test_wrong_orders_are_one_line_and_two(
    order: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    order = [word.replace("{tmp}", str(tmp_path)) for word in order]
    assert main(["--out", str(tmp_path / "out"), *order]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("torchhand learn_pose: error: ")
    assert message in printed.err
    assert printed.err.count("\n") == 1
    assert not (tmp_path / "out" / "model.pt").exists()


def test_an_older_training_is_refused_and_settings_that_differ_too(
    finished: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--out", str(finished), *SMALL]) == 2
    assert "holds model.pt of an earlier training" in capsys.readouterr().err
    assert main(["--out", str(finished), "--resume", "--seed", "7"]) == 2
    assert "--seed: expected 0, as " in capsys.readouterr().err
    assert main(["--out", str(finished), "--overwrite", "--steps", "5", "--seed", "7", "--pool", "50"]) == 0
    assert load_record(finished).settings.seed == 7


def test_help_has_an_example(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    assert "torchhand learn_pose --out" in capsys.readouterr().out
