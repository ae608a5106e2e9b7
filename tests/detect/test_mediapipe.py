"""MediaPipe's hands in our conventions, where it is installed; else the one line that says how to get it."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
import torch

from torchhand.detect import HandDetector, MediaPipe
from torchhand.errors import InputError
from torchhand.files import models_dir, read_picture
from torchhand.hand import Side

HAS_MEDIAPIPE = importlib.util.find_spec("mediapipe") is not None


def _solutions() -> MediaPipe:
    if not HAS_MEDIAPIPE:
        pytest.skip("needs mediapipe (pip install torchhand[mediapipe])")
    try:
        return MediaPipe()
    except InputError as error:
        pytest.skip(str(error))


def _palm() -> torch.Tensor:
    return read_picture(models_dir() / "generic_hand" / "palm.png")


@pytest.mark.skipif(HAS_MEDIAPIPE, reason="mediapipe is installed")
def test_without_mediapipe_one_line_says_how_to_get_it() -> None:
    with pytest.raises(InputError, match=r"pip install torchhand\[mediapipe\]"):
        MediaPipe()


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_side_is_the_hand_s_own(side: Side) -> None:
    picture = _palm() if side == "right" else _palm().flip(1)
    landmarks = _solutions().open(1)
    (hand,) = landmarks.detect(picture.contiguous())
    landmarks.close()
    assert hand.label == side


def test_a_point_is_where_it_is_in_the_picture() -> None:
    """The middle finger of the known picture points up from the wrist; the first pixel's centre is (0, 0), so a picture
    that is mirrored mirrors its points about (width - 1) / 2."""
    picture, landmarks = _palm(), _solutions()
    found = []
    for one in (picture, picture.flip(1).contiguous()):
        opened = landmarks.open(1)
        (hand,) = opened.detect(one)
        opened.close()
        assert hand.picture is not None
        found.append(hand.picture)
    straight, mirrored = found
    mirrored[:, 0] = picture.shape[1] - 1 - mirrored[:, 0]
    assert np.abs(straight - mirrored).mean() < 3.0  # the network sees the two a little differently
    assert straight[12, 1] < straight[9, 1] < straight[0, 1]
    is_skin = (picture.numpy().astype(int).max(-1) - picture.numpy().astype(int).min(-1)) > 30
    inside = [is_skin[round(y), round(x)] for x, y in straight]
    assert np.mean(inside) > 0.9


def test_its_points_are_those_of_the_stored_detections(data_dir: Path) -> None:
    _solutions()
    folder = data_dir / "synthetic" / "rom_palm"
    stored = np.load(folder / "mediapipe.npz")
    detector = HandDetector(side="right")
    for index, path in enumerate(sorted((folder / "frames").iterdir())[:12]):
        seen = detector(read_picture(path))
        assert seen is not None
        assert seen.points is not None
        assert np.abs(seen.points_px.numpy() - stored["points_px"][index]).max() < 0.5
        assert np.abs(seen.points.numpy() - stored["world"][index]).max() < 1e-3
    detector.close()


def test_the_same_pictures_give_the_same_points() -> None:
    _solutions()
    palm, found = _palm(), []
    shifted = palm.roll((4, 9), (0, 1))
    for _ in range(2):
        detector = HandDetector(side="right")
        seen = [detector(picture) for picture in (palm, shifted)]
        detector.close()
        found.append(torch.stack([one.points_px for one in seen if one is not None]))
    assert found[0].shape == (2, 21, 2)
    assert torch.equal(found[0], found[1])


def test_a_model_that_is_none_is_refused(tmp_path: Path) -> None:
    if not HAS_MEDIAPIPE:
        pytest.skip("needs mediapipe (pip install torchhand[mediapipe])")
    with pytest.raises(InputError, match="found no such file"):
        MediaPipe(tmp_path / "hand_landmarker.task")
    (tmp_path / "hand_landmarker.task").write_text("no model")
    with pytest.raises(InputError, match=r"expected a hand_landmarker\.task that mediapipe can read"):
        MediaPipe(tmp_path / "hand_landmarker.task").open(1)
