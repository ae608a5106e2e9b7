"""`torchhand simulate`: sequences as the user orders them, and one line where an order cannot be met."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch

from torchhand.cli import simulate
from torchhand.cli.command import threads
from torchhand.cli.simulate import main
from torchhand.evaluate import flexion_deg, load_truth
from torchhand.files import load_cameras, load_hand_model, open_source, save_cameras, save_hand
from torchhand.geometry import assumed_camera
from torchhand.simulate import render_sequence

SMALL = ("--size", "64x48", "--frames", "2")


def _truth(folder: Path) -> dict[str, np.ndarray]:
    with np.load(folder / "truth.npz") as stored:
        return dict(stored)


def test_a_sequence_is_rendered(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert main(["--out", str(out), "--motion", "free", "--background", "dark", "--seed", "3", *SMALL]) == 0
    printed = capsys.readouterr()
    assert printed.out == f"saved 2 frames in {out}\n"
    assert printed.err == ""  # no progress bar where nobody watches
    truth = load_truth(out)
    assert truth.frames == 2
    assert truth.keypoints3d is not None
    np.testing.assert_array_equal(truth.flexion_deg, flexion_deg(truth.keypoints3d))
    [camera] = load_cameras(out / "cameras.json")
    assert (camera.width, camera.height) == (64, 48)
    with open_source(out / "frames") as source:
        assert [(frame.index, frame.problem) for frame in source] == [(0, None), (1, None)]
    about = json.loads((out / "about.json").read_text())
    assert about["arguments"]["seed"] == 3
    assert about["motion"] == "free"
    assert about["hand"] == "right"


def test_the_same_order_gives_the_same_bytes_and_another_seed_does_not(tmp_path: Path) -> None:
    for name, seed in (("one", "5"), ("two", "5"), ("three", "6")):
        order = ["--out", str(tmp_path / name), "--seed", seed, "--background", "clutter", "--random-hand", *SMALL]
        assert main(order) == 0
    one, two, three = (tmp_path / name for name in ("one", "two", "three"))
    for file in sorted(path for path in one.rglob("*") if path.is_file()):
        assert file.read_bytes() == (two / file.relative_to(one)).read_bytes(), file.name
    assert (_truth(one)["shape"] != _truth(three)["shape"]).all()
    assert (one / "frames" / "0001.jpg").read_bytes() != (three / "frames" / "0001.jpg").read_bytes()


def test_one_thread_unless_ordered_otherwise(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []

    def render(*args: Any, **options: Any) -> Any:
        seen.append(torch.get_num_threads())
        return render_sequence(*args, **options)

    monkeypatch.setattr(simulate, "render_sequence", render)
    with threads(2):
        assert main(["--out", str(tmp_path / "one"), *SMALL]) == 0
        assert main(["--out", str(tmp_path / "three"), "--threads", "3", *SMALL]) == 0
        assert torch.get_num_threads() == 2
    assert seen == [1, 3]
    about = [json.loads((tmp_path / name / "about.json").read_text()) for name in ("one", "three")]
    assert about[0] == about[1]  # says nothing about threads


def test_hand_and_side_and_camera_from_files(tmp_path: Path) -> None:
    space = load_hand_model().shape_space
    shape = (space.default + 0.5 * space.std).tolist()
    save_hand(tmp_path / "hand.json", space.names, shape, "left", {}, units=space.units)
    save_cameras([assumed_camera(70, 50, horizontal_fov_deg=60.0)], tmp_path / "cameras.json")
    order = ["--hand", str(tmp_path / "hand.json"), "--camera", str(tmp_path / "cameras.json"), "--frames", "1"]
    assert main(["--out", str(tmp_path / "left"), *order]) == 0
    assert main(["--out", str(tmp_path / "right"), "--side", "right", *order]) == 0
    left, right = _truth(tmp_path / "left"), _truth(tmp_path / "right")
    assert (str(left["side"]), str(right["side"])) == ("left", "right")
    np.testing.assert_array_equal(left["shape"], shape)
    np.testing.assert_allclose(left["keypoints3d"], right["keypoints3d"] * [-1, 1, 1], rtol=0, atol=1e-12)
    [camera] = load_cameras(tmp_path / "left" / "cameras.json")
    assert torch.equal(camera.intrinsics, assumed_camera(70, 50, horizontal_fov_deg=60.0).intrinsics)


def test_a_recording_is_played(tmp_path: Path) -> None:
    row = "2020 1 1 0 0 {t} 1 " + " ".join(["0"] * 4 + ["{bend}"] + ["0"] * 18)
    rows = [row.format(t=t, bend=-0.5 * t) for t in range(4)]
    (tmp_path / "glove.txt").write_text("\n".join(rows))
    recorded = ["--recorded", str(tmp_path / "glove.txt"), "--recorded-start", "1", "--fps", "2", *SMALL]
    assert main(["--out", str(tmp_path / "out"), *recorded]) == 0
    truth = _truth(tmp_path / "out")
    column = truth["dof_names"].tolist().index("index_mcp_fe")
    np.testing.assert_allclose(truth["pose"][:, column], [0.5, 0.75], rtol=0, atol=1e-9)


def test_the_mesh_as_ordered(tmp_path: Path) -> None:
    for surface in ("primitives", "mesh"):
        order = ["--surface", surface, "--side", "left", "--random-hand", "--pictures", "png", *SMALL]
        assert main(["--out", str(tmp_path / surface), *order]) == 0
    assert json.loads((tmp_path / "mesh" / "about.json").read_text())["arguments"]["surface"] == "mesh"
    quadrics, skin = (_truth(tmp_path / name) for name in ("primitives", "mesh"))
    np.testing.assert_allclose(skin["keypoints3d"], quadrics["keypoints3d"], rtol=0, atol=1e-12)
    names = (str(tmp_path / surface / "masks" / "0000.png") for surface in ("primitives", "mesh"))
    one, other = (np.asarray(cv2.imread(name, cv2.IMREAD_GRAYSCALE)) > 0 for name in names)
    assert 0.8 < (one & other).sum() / (one | other).sum() < 1


def test_pictures_noise_and_video_as_ordered(tmp_path: Path) -> None:
    order = ["--noise", "0", "--blur-px", "0", "--shutter", "0.5", "--forearm", "--pictures", "png", "--video", *SMALL]
    assert main(["--out", str(tmp_path / "out"), *order]) == 0
    assert sorted(path.name for path in (tmp_path / "out" / "frames").iterdir()) == ["0000.png", "0001.png"]
    with open_source(tmp_path / "out" / "video.mp4") as source:
        assert sum(frame.image is not None for frame in source) == 2


@pytest.mark.parametrize(
    ("order", "message"),
    [
        (["--size", "640"], "--size: expected WIDTHxHEIGHT in px"),
        (["--size", "4x4"], "--size: expected WIDTHxHEIGHT in px, each 16 to 8192"),
        (["--frames", "0"], "--frames: expected 1 to 100000, got 0"),
        (["--fps", "0"], "--fps: expected 0.1 to 1000"),
        (["--pace", "nan"], "--pace: expected 0 to 20"),
        (
            ["--motion", "dance"],
            "--motion: expected one of abduction, flexion, free, greet, leave, planar, planar_point, wave, got 'dance'",
        ),
        (["--surface", "clay"], "--surface: expected mesh or primitives, got 'clay'"),
        (["--noise", "-1"], "noise: expected 0 to 100, got -1"),
        (["--shutter", "2"], "shutter: expected 0 to 1, got 2"),
        (["--recorded", "{tmp}/gone.txt"], "gone.txt: cannot be read (No such file"),
        (["--camera", "{tmp}/gone.json"], "gone.json"),
        (["--camera", "{tmp}/two.json"], "two.json: expected one camera, got 2 (a, b)"),
        (["--hand", "{tmp}/gone.json"], "gone.json"),
        (["--hand", "{tmp}/huge.json"], "huge.json: shape.hand_length: expected 0.14 to 0.24, got 2"),
        (["--hand", "{tmp}/huge.json", "--random-hand"], "at most one of --hand and --random-hand"),
        (["--threads", "0"], "--threads: expected 1 to 1024, got 0"),
        (["--unknown", "1"], "--unknown"),
    ],
)
def test_wrong_orders_are_one_line_and_two(
    order: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    space = load_hand_model().shape_space
    huge = [2.0, *space.default[1:].tolist()]
    save_hand(tmp_path / "huge.json", space.names, huge, "left", {}, units=space.units)
    save_cameras([replace(assumed_camera(64, 48), name=name) for name in ("a", "b")], tmp_path / "two.json")
    order = [word.replace("{tmp}", str(tmp_path)) for word in order]
    assert main(["--out", str(tmp_path / "out"), *order]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("torchhand simulate: error: ")
    assert message in printed.err
    assert printed.err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_an_older_sequence_is_refused_then_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    order = ["--out", str(tmp_path / "out"), *SMALL]
    assert main(order) == 0
    assert main(order) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert main([*order, "--overwrite", "--motion", "wave"]) == 0
    assert json.loads((tmp_path / "out" / "about.json").read_text())["motion"] == "wave"


def test_help_has_an_example(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    assert "torchhand simulate --out" in capsys.readouterr().out
