"""Inputs of runs over single pictures: which pictures, whose camera, whose keypoints."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from torch import Tensor

from torchhand.detect import Landmarks
from torchhand.errors import InputError
from torchhand.files import HandDetection, save_cameras
from torchhand.geometry import assumed_camera
from torchhand.hand import Side
from torchhand.runs.pictures.inputs import KeypointsFile, PictureDetector, cameras_of, mask_of, pictures_in

IMAGE = torch.zeros(480, 640, 3, dtype=torch.uint8)
MATRIX = np.array(((480.0, 0.0, 31.0), (0.0, 470.0, 23.0), (0.0, 0.0, 1.0)))


def write(path: Path, *, size: tuple[int, int] = (48, 64), value: int = 90) -> Path:
    cv2.imwrite(str(path), np.full((*size, 3), value, np.uint8))
    return path


def arrays(path: Path, **own: np.ndarray) -> Path:
    np.savez(path, **own)  # pyright: ignore[reportArgumentType]
    return path


def test_pictures_come_in_natural_order_without_their_silhouettes(tmp_path: Path) -> None:
    for name in ("b10.png", "b9.png", "b9_mask.png", "lonely_mask.png", "notes.txt"):
        write(tmp_path / name) if name.endswith("png") else (tmp_path / name).write_text("")
    assert [path.name for path in pictures_in(tmp_path)] == ["b9.png", "b10.png", "lonely_mask.png"]


@pytest.mark.parametrize("name", ["missing.png", "notes.txt", "empty"])
def test_sources_without_pictures_are_told(tmp_path: Path, name: str) -> None:
    (tmp_path / "notes.txt").write_text("")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=name):
        pictures_in(tmp_path / name)


def test_intrinsics_are_matched_by_name(tmp_path: Path) -> None:
    other = MATRIX + np.array(((20.0, 0, 0), (0, 0, 0), (0, 0, 0)))
    file = arrays(tmp_path / "truth.npz", K=np.stack((MATRIX, other)), image=np.array(["b.png", "a.png"]))
    camera = cameras_of(file, ["a.png", "b.png"])(0, 64, 48)
    assert camera.intrinsics.tolist() == other.tolist()
    assert (camera.width, camera.height, camera.is_assumed) == (64, 48, False)
    with pytest.raises(InputError, match=r"c\.png"):
        cameras_of(file, ["a.png", "c.png"])


def test_intrinsics_without_names_are_in_the_pictures_order(tmp_path: Path) -> None:
    file = arrays(tmp_path / "cameras.npz", K=np.stack((MATRIX, 2 * MATRIX - np.diag((0, 0, 1.0)))))
    assert float(cameras_of(file, ["b.png", "a.png"])(1, 64, 48).intrinsics[0, 0]) == 960.0
    with pytest.raises(InputError, match="3 pictures, got 2"):
        cameras_of(file, ["a.png", "b.png", "c.png"])


def keypoints(path: Path, **own: np.ndarray) -> Path:
    points = np.arange(3 * 21 * 2, dtype=np.float32).reshape(3, 21, 2)
    return arrays(path, points_px=points, score=np.array((0.9, 0.8, 0.7), np.float32), **own)


def test_keypoints_are_matched_by_name_and_tell_the_side(tmp_path: Path) -> None:
    names, labels = np.array(["a.png", "b.png", "c.png"]), np.array(["Left", "Right", ""])
    path = keypoints(tmp_path / "mp.npz", image=names, label=labels)
    file = KeypointsFile(path, side=None, pictures=names.tolist())
    found = file.hand(4, "b.png", IMAGE)
    assert found.keypoints is not None
    assert found.side == "left"  # MediaPipe's name of a hand in a picture that is no mirror image
    assert found.keypoints.points_px[0].tolist() == [42.0, 43.0]
    assert found.keypoints.score == pytest.approx(0.8)
    assert file.hand(0, "a.png", IMAGE).side == "right"
    only = KeypointsFile(path, side="right", pictures=names.tolist())
    assert only.hand(1, "b.png", IMAGE).keypoints is None


@pytest.mark.parametrize("side", [None, "right", "left"])
def test_a_file_is_silent_where_it_tells_of_no_hand_in_a_picture(tmp_path: Path, side: Side | None) -> None:
    names, labels = np.array(["a.png", "b.png", "c.png"]), np.array(["Left", "Right", ""])
    path = keypoints(tmp_path / "mp.npz", image=names, label=labels)
    with np.load(path) as stored:
        told = dict(stored)
    told["points_px"][2] = np.nan
    np.savez(path, **told)
    file = KeypointsFile(path, side=side, pictures=names.tolist())
    silent = {name: file.hand(0, name, IMAGE).is_silent for name in ("a.png", "b.png", "c.png", "missing.png")}
    assert silent == {"a.png": False, "b.png": False, "c.png": True, "missing.png": False}


def test_keypoints_without_names_are_in_the_pictures_order(tmp_path: Path) -> None:
    path = keypoints(tmp_path / "mp.npz")
    found = KeypointsFile(path, side=None, pictures=["a", "b", "c"]).hand(2, "any.png", IMAGE)
    assert found.keypoints is not None
    assert found.side is None
    with pytest.raises(InputError, match="one row for each of 2 pictures"):
        KeypointsFile(path, side=None, pictures=["a", "b"])


def _detected(x: float, side: Side, score: float) -> HandDetection:
    return HandDetection(picture=np.full((21, 2), x), space=None, confidence=None, label=side, score=score)


@dataclass
class Following:
    """A `Landmarker` that finds a hand in the first picture that it is given, and in later ones what it saw before."""

    name: str = "following"
    opened: int = 0

    def open(self, hands: int) -> Landmarks:
        self.opened += 1

        class Found:
            last: Sequence[HandDetection] = ()

            def detect(self, image: Tensor) -> Sequence[HandDetection]:
                x = float(image[0, 0, 0])
                self.last = self.last or (_detected(x, "left", 0.7), _detected(x + 1, "right", 0.9))[:hands]
                return self.last

            def close(self) -> None: ...

        return Found()


def test_keypoints_of_other_pictures_are_refused(tmp_path: Path) -> None:
    names = np.array(["a.png", "b.png", "c.png"])
    path = keypoints(tmp_path / "mp.npz", image=names)
    assert KeypointsFile(path, side=None, pictures=["c.png", "d.png"]).hand(0, "c.png", IMAGE).keypoints
    with pytest.raises(InputError, match=r"image: expected names of the pictures, such as d\.png, got a\.png"):
        KeypointsFile(path, side=None, pictures=["d.png", "e.png"])


def test_a_file_of_several_cameras_is_refused_before_any_picture(tmp_path: Path) -> None:
    one = assumed_camera(64, 48)
    save_cameras([replace(one, name="left"), replace(one, name="right")], tmp_path / "cameras.json")
    with pytest.raises(InputError, match=r"expected one camera, got 2 \(left, right\)"):
        cameras_of(tmp_path / "cameras.json", ["a.png"])


def test_a_detector_sees_every_picture_by_itself() -> None:
    landmarker = Following()
    cases: list[tuple[Side | None, Side, int]] = [(None, "right", 1), ("right", "right", 1), ("left", "left", 0)]
    for own, side, further in cases:
        detector = PictureDetector(side=own, hand_model=None, landmarker=landmarker)
        for level in (10, 20):
            found = detector.hand(0, "a.png", IMAGE + level)
            assert found.keypoints is not None
            assert (found.side, float(found.keypoints.points_px[3, 0])) == (side, level + further)
    assert landmarker.opened == 6


def test_a_detector_is_silent_where_it_finds_no_hand_of_either_side() -> None:
    class Seen:
        name = "seen"
        hands: Sequence[HandDetection] = ()

        def open(self, hands: int) -> "Seen":
            return self

        def detect(self, image: Tensor) -> Sequence[HandDetection]:
            return self.hands

        def close(self) -> None: ...

    seen = Seen()
    detector = PictureDetector(side="right", hand_model=None, landmarker=seen)
    assert detector.hand(0, "a.png", IMAGE).is_silent
    seen.hands = (_detected(1.0, "left", 0.9),)
    found = detector.hand(0, "a.png", IMAGE)
    assert found.keypoints is None
    assert not found.is_silent


def test_silhouettes_are_found_by_name(tmp_path: Path) -> None:
    picture = write(tmp_path / "a.png")
    masks = tmp_path / "masks"
    masks.mkdir()
    write(masks / "a.png", value=255)
    found = mask_of(picture, masks, (48, 64))
    assert found is not None
    assert bool(found.all())
    assert mask_of(picture, None, (48, 64)) is None
    with pytest.raises(InputError, match="64x48"):
        mask_of(picture, masks, (50, 64))
    with pytest.raises(InputError, match="b_mask"):
        mask_of(tmp_path / "b.png", masks, (48, 64))
