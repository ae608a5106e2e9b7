"""A sequence as a folder: complete, readable by those who judge, never half-written."""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from torchhand.errors import InputError
from torchhand.evaluate import flexion_deg, load_truth
from torchhand.files import load_cameras, load_hand_model, open_source
from torchhand.geometry import assumed_camera
from torchhand.hand import DOFS
from torchhand.simulate.folder import SequenceFolder
from torchhand.simulate.motion import scripted_motion
from torchhand.simulate.scene import RenderedFrame, SceneSettings, render_sequence
from torchhand.simulate.writer import MovingHand, write_sequence

CAMERA = assumed_camera(64, 48, horizontal_fov_deg=48.0)
KINEMATICS = load_hand_model().kinematics("right", dtype=torch.float64)
SHAPE = KINEMATICS.default_shape
FRAMES = 3


def _write(out: Path, rendered: Iterator[RenderedFrame] | None = None, **options) -> list[RenderedFrame]:
    motion = scripted_motion("planar", FRAMES, KINEMATICS, CAMERA, torch.Generator().manual_seed(2))
    scene = SceneSettings(supersampling=1)
    frames = list(render_sequence(KINEMATICS, motion, CAMERA, scene, torch.Generator().manual_seed(2)))
    hand = MovingHand(kinematics=KINEMATICS, shape=SHAPE, motion=motion)
    folder = SequenceFolder(
        path=out, **{name: options.pop(name) for name in ("picture_format", "overwrite") & options.keys()}
    )
    write_sequence(folder, iter(frames) if rendered is None else rendered, hand, CAMERA, **options)
    return frames


def _broken_off(error: BaseException) -> Iterator[RenderedFrame]:
    motion = scripted_motion("planar", FRAMES, KINEMATICS, CAMERA, torch.Generator().manual_seed(2))
    scene = SceneSettings(supersampling=1)
    yield next(iter(render_sequence(KINEMATICS, motion, CAMERA, scene, torch.Generator())))
    raise error


def test_everything_is_there_and_right(tmp_path: Path) -> None:
    out = tmp_path / "new" / "sequence"
    frames = _write(out, picture_format="png", measures={"flexion_deg": flexion_deg}, about={"seed": 2})
    assert sorted(entry.name for entry in out.iterdir()) == [
        "about.json",
        "cameras.json",
        "frames",
        "masks",
        "truth.npz",
    ]
    with open_source(out / "frames") as source:
        pictures = [frame.image for frame in source]
    assert len(pictures) == FRAMES
    truth = load_truth(out)
    assert truth.keypoints3d is not None
    assert truth.keypoints2d is not None
    for frame, picture in zip(frames, pictures, strict=True):
        assert picture is not None
        assert torch.equal(picture, frame.image)
        mask = cv2.imread(str(truth.mask_files[frame.index]), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(mask, 255 * frame.mask.numpy().astype(np.uint8))
        np.testing.assert_array_equal(truth.keypoints3d[frame.index], frame.keypoints_cam.numpy())
        np.testing.assert_array_equal(truth.keypoints2d[frame.index], frame.keypoints_px.numpy())
    np.testing.assert_array_equal(truth.flexion_deg, flexion_deg(truth.keypoints3d))
    [camera] = load_cameras(out / "cameras.json")
    np.testing.assert_allclose(
        camera.project(torch.from_numpy(truth.keypoints3d)), truth.keypoints2d, rtol=0, atol=1e-9
    )


def test_the_truth_rebuilds_the_hand(tmp_path: Path) -> None:
    _write(tmp_path / "out")
    with np.load(tmp_path / "out" / "truth.npz") as truth:
        assert tuple(truth["dof_names"]) == DOFS
        assert tuple(truth["shape_names"]) == KINEMATICS.shape_space.names
        assert truth["frame"].tolist() == [0, 1, 2]
        assert truth["in_view"].tolist() == [True] * 3
        pose, shape = torch.from_numpy(truth["pose"]), torch.from_numpy(truth["shape"])
        frames = KINEMATICS(pose, shape, root_reference=torch.from_numpy(truth["root_reference"]))
        np.testing.assert_allclose(frames.keypoints, truth["keypoints3d"], rtol=0, atol=1e-12)
        np.testing.assert_allclose(frames.rotation[:, 0], truth["root_rotation"], rtol=0, atol=1e-12)


def test_jpeg_and_video(tmp_path: Path) -> None:
    frames = _write(tmp_path / "out", with_video=True)
    for inside in ("frames", "video.mp4"):
        with open_source(tmp_path / "out" / inside) as source:
            pictures = [frame.image for frame in source]
        assert len(pictures) == FRAMES
        for picture, frame in zip(pictures, frames, strict=True):
            assert picture is not None
            assert (picture.double() - frame.image.double()).abs().mean() < 8


def test_the_same_twice_is_the_same_to_the_bit(tmp_path: Path) -> None:
    for name in ("one", "two"):
        _write(tmp_path / name, about={"seed": 2})
    for file in sorted(path for path in (tmp_path / "one").rglob("*") if path.is_file()):
        assert file.read_bytes() == (tmp_path / "two" / file.relative_to(tmp_path / "one")).read_bytes(), file.name


@pytest.mark.parametrize("error", [KeyboardInterrupt(), RuntimeError("render")], ids=["ctrl-c", "error"])
def test_an_interrupted_run_leaves_nothing(error: BaseException, tmp_path: Path) -> None:
    with pytest.raises(type(error)):
        _write(tmp_path / "out", _broken_off(error), with_video=True)
    assert list(tmp_path.iterdir()) == []


def test_an_interrupted_run_keeps_the_older_sequence(tmp_path: Path) -> None:
    _write(tmp_path / "out")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    with pytest.raises(KeyboardInterrupt):
        _write(tmp_path / "out", _broken_off(KeyboardInterrupt()), overwrite=True)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_a_full_disk_is_explained_and_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", refuse)
    with pytest.raises(InputError, match=r"out: cannot be written \(no space left"):
        _write(tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_an_older_sequence_is_replaced_only_when_asked(tmp_path: Path) -> None:
    _write(tmp_path / "out", with_video=True)
    with pytest.raises(InputError, match=r"not empty \(about.json, cameras.json, frames, .*--overwrite"):
        _write(tmp_path / "out")
    _write(tmp_path / "out", overwrite=True, picture_format="png")
    assert not (tmp_path / "out" / "video.mp4").exists()
    assert [path.suffix for path in (tmp_path / "out" / "frames").iterdir()] == [".png"] * FRAMES
    assert [entry.name for entry in tmp_path.iterdir()] == ["out"]


def test_nothing_foreign_is_deleted(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match=r"holds thesis\.tex, which is no part"):
        _write(tmp_path / "out", overwrite=True)
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="expected a folder for the sequence, got a file"):
        _write(tmp_path / "file", overwrite=True)
    with pytest.raises(InputError, match="cannot be written"):
        _write(tmp_path / "file" / "below")
    assert (tmp_path / "out" / "thesis.tex").read_text() == "years of work"


def test_an_empty_folder_may_be_used(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    _write(tmp_path / "out")
    assert (tmp_path / "out" / "truth.npz").exists()


def test_missing_frames_are_noticed(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="expected 3 frames, got 0"):
        _write(tmp_path / "out", iter(()))
    assert list(tmp_path.iterdir()) == []
