"""The command for single pictures: results, refusals, resuming, replacing."""

import os
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from tests.studio import StagedHand, Studio
from torchhand import fit_pose
from torchhand.cli.evaluate import main as evaluate
from torchhand.cli.fit_pose import main
from torchhand.files import HandDetection, load_track
from torchhand.hand import posture
from torchhand.track import HandKeypoints


def staged(name: str) -> StagedHand:
    placed = Studio().placed(size=0.8)
    angles = placed.kinematics.skeleton.within_limits(posture(name, dtype=torch.float64)[6:]).to(placed.pose)
    return replace(placed, pose=torch.cat((placed.pose[:6], angles)))


def keypoints_of(placed: StagedHand) -> torch.Tensor:
    return placed.projector.frames(placed.pose, placed.root_reference).keypoints


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two hands, a wall and a broken file, with keypoints, cameras and the truth, in another order than the names'."""
    folder = tmp_path_factory.mktemp("pictures")
    hands = {"b.png": staged("point"), "a.png": staged("fist")}
    for name, placed in hands.items():
        cv2.imwrite(str(folder / name), placed.picture().numpy()[..., ::-1])
    cv2.imwrite(str(folder / "wall.png"), np.full((160, 200, 3), 120, np.uint8))
    (folder / "z_broken.png").write_bytes(b"\x89PNG broken")
    names = np.array([*hands, "wall.png", "z_broken.png"])
    points = [keypoints_of(placed) for placed in hands.values()]
    nothing = np.full((2, 21, 3), np.nan)
    world = np.concatenate([np.stack([(one - one.mean(0)).numpy() for one in points]), nothing])
    px = np.stack([placed.keypoints_px.numpy() for placed in hands.values()])
    px = np.concatenate([px, nothing[..., :2]])
    label = np.array(["Left", "Left", "", ""])
    np.savez(folder / "mediapipe.npz", image=names, points_px=px, world=world, label=label)
    intrinsics = np.stack([next(iter(hands.values())).camera.intrinsics.numpy()] * 4)
    truth = np.concatenate([np.stack([one.numpy() for one in points]), nothing])
    np.savez(folder / "truth.npz", image=names, K=intrinsics, keypoints3d=truth)
    return folder


def run(pictures: Path, out: Path, *extra: str) -> int:
    files = {"--camera": "truth.npz", "--keypoints": "mediapipe.npz"}
    given = [text for option, name in files.items() for text in (option, str(pictures / name))]
    return main([str(pictures), "--out", str(out), *given, *extra])


def test_a_folder_is_fitted_judged_resumed_and_replaced(
    pictures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert run(pictures, out) == 0
    told = capsys.readouterr()
    assert "4 pictures: 2 hands, 2 refused" in told.out
    assert "wall.png: no hand: " in told.err
    assert "z_broken.png" in told.err
    with np.load(out / "poses.npz") as stored:
        poses = dict(stored)
    assert poses["image"].tolist() == ["a.png", "b.png", "wall.png", "z_broken.png"]
    assert poses["status"].tolist() == ["tracked", "tracked", "no_hand", "no_hand"]
    assert poses["side"].tolist()[:2] == ["right", "right"]
    assert np.isnan(poses["pose"][2:]).all()
    assert poses["shape"].shape == (4, len(poses["shape_names"]))
    assert [path.name for path in sorted((out / "overlays").iterdir())] == ["a.png", "b.png", "wall.png"]

    assert evaluate([str(out), str(pictures / "truth.npz")]) == 0
    assert "flexion" in capsys.readouterr().out
    track = load_track(out)
    truth = {"a.png": keypoints_of(staged("fist")), "b.png": keypoints_of(staged("point"))}
    for row, name in enumerate(("a.png", "b.png")):
        found = track.keypoints3d[row] - track.keypoints3d[row, 0]
        wanted = (truth[name] - truth[name][0]).numpy()
        assert np.linalg.norm(found - wanted, axis=-1).mean() < 0.015

    assert run(pictures, out) == 2
    assert "--resume" in capsys.readouterr().err

    lines = (out / "poses.jsonl").read_text().splitlines(keepends=True)
    (out / "poses.jsonl").write_text("".join(lines[:2]) + lines[2][:40])  # as a killed run leaves it
    (out / "poses.npz").unlink()
    assert run(pictures, out, "--resume") == 0
    with np.load(out / "poses.npz") as stored:
        np.testing.assert_array_equal(stored["pose"], poses["pose"])
        np.testing.assert_array_equal(stored["image"], poses["image"])

    assert run(pictures, out, "--resume", "--side", "right") == 2
    assert "cannot be resumed: side" in capsys.readouterr().err


def test_a_grey_picture_is_refused_without_advice_that_the_command_does_not_take(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    grey = cv2.cvtColor(staged("open").picture().numpy(), cv2.COLOR_RGB2GRAY)
    cv2.imwrite(str(tmp_path / "grey.png"), grey)
    assert main([str(tmp_path / "grey.png"), "--out", str(tmp_path / "out")]) == 0
    told = capsys.readouterr().err
    assert "grey.png: no hand: the picture is grey" in told
    assert "--" not in told.split("grey.png: ")[1]


def test_pictures_of_one_name_have_overlays_of_their_own(tmp_path: Path) -> None:
    folder = tmp_path / "walls"
    folder.mkdir()
    wall = np.full((160, 200, 3), 120, np.uint8)
    for name in ("a.png", "a.jpg", "a.jpg.bmp", "b.jpg"):
        cv2.imwrite(str(folder / name), wall)
    assert main([str(folder), "--out", str(tmp_path / "out")]) == 0
    drawn = sorted(path.name for path in (tmp_path / "out" / "overlays").iterdir())
    assert drawn == ["a.jpg.bmp.png", "a.jpg.png", "a.png.png", "b.png"]


def test_pictures_side_by_side_give_the_bytes_of_one_after_the_other(
    pictures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for workers in ("1", "3"):
        assert run(pictures, tmp_path / workers, "--workers", workers) == 0
    alone, together = (dict(np.load(tmp_path / workers / "poses.npz")) for workers in ("1", "3"))
    for name in alone.keys() - {"seconds"}:
        np.testing.assert_array_equal(alone[name], together[name])
    for picture in sorted((tmp_path / "1" / "overlays").iterdir()):
        assert picture.read_bytes() == (tmp_path / "3" / "overlays" / picture.name).read_bytes()
    capsys.readouterr()
    assert run(pictures, tmp_path / "none", "--workers", "0") == 2
    assert "--workers: expected 1 to 1024, got 0" in capsys.readouterr().err


class _OfOneProcess:
    """A detector that finds nothing, and that no copy of its process can run, as MediaPipe."""

    name = "detector of one process"

    def __init__(self, hand_model: Path | None) -> None:
        self._process = os.getpid()

    def open(self, hands: int) -> "_OfOneProcess":
        return self

    def detect(self, image: torch.Tensor) -> list[HandDetection]:
        assert os.getpid() == self._process
        return []

    def close(self) -> None:
        pass


def test_every_copy_has_a_detector_of_its_own(pictures: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("torchhand.runs.pictures.inputs.MediaPipe", _OfOneProcess)
    out = tmp_path / "out"
    assert main([str(pictures), "--out", str(out), "--keypoints", "mediapipe", "--workers", "3"]) == 0
    track = load_track(out)
    assert track.status.tolist() == ["no_hand"] * 4
    assert track.header["made_with"]["keypoints"] == _OfOneProcess.name


def test_a_run_that_is_to_replace_another_leaves_that_until_it_has_ended(
    pictures: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    wall = str(pictures / "wall.png")
    assert main([wall, "--out", str(out), "--no-overlays"]) == 0
    before = (out / "poses.npz").read_bytes()

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr("torchhand.runs.pictures.run._fitted", stop)
        assert main([wall, "--out", str(out), "--overwrite"]) == 130
    assert (out / "poses.npz").read_bytes() == before
    assert "--resume" in capsys.readouterr().err
    assert main([wall, "--out", str(out), "--overwrite"]) == 0
    assert not (out / "unfinished").exists()
    assert (out / "overlays" / "wall.png").is_file()


def test_a_run_knows_its_files_by_their_content(
    pictures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, points = tmp_path / "out", tmp_path / "points.npz"
    with np.load(pictures / "mediapipe.npz") as stored:
        arrays = dict(stored)
    np.savez(points, **arrays)
    given = [str(pictures / "wall.png"), "--out", str(out), "--keypoints", str(points), "--no-overlays"]
    assert main(given) == 0
    assert main([*given, "--resume"]) == 0
    np.savez(points, **arrays | {"points_px": arrays["points_px"] + 1})
    assert main([*given, "--resume"]) == 2
    assert "cannot be resumed: made_with.keypoints was" in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["missing.png"], "no such file"),
        (["z_broken.png"], "z_broken.png"),
        (["wall.png", "--camera", "mediapipe.npz"], "K: expected intrinsics"),
        (["wall.png", "--keypoints", "missing.npz"], "no such file"),
        (["wall.png", "--masks", "missing"], "--masks"),
        (["wall.png", "--hand-model", "hand_landmarker.task"], "--hand-model: expected --keypoints mediapipe"),
    ],
)
def test_mistakes_are_told_in_one_line(
    pictures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], text: str
) -> None:
    given = [one if one.startswith("--") else str(pictures / one) for one in arguments]
    assert main([*given, "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert error.startswith("torchhand fit_pose: error: ")
    assert text in error


def test_the_short_way(pictures: Path) -> None:
    placed = staged("point")
    points = keypoints_of(placed)
    seen = HandKeypoints(points_px=placed.keypoints_px, points=points - points.mean(0), score=0.9)
    found = fit_pose(pictures / "b.png", camera=placed.camera, shape=placed.shape, keypoints=seen)
    assert found.estimate.status == "tracked"
    assert found.estimate.keypoints_px is not None
    assert float((found.estimate.keypoints_px[0] - placed.keypoints_px).norm(dim=-1).mean()) < 4.0


def test_a_detector_that_is_not_installed_is_told_with_the_way_to_have_it(
    pictures: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "mediapipe", None)
    assert main([str(pictures), "--out", str(tmp_path / "out"), "--keypoints", "mediapipe"]) == 2
    assert "pip install torchhand[mediapipe]" in capsys.readouterr().err.splitlines()[-1]
    assert not (tmp_path / "out").exists()
