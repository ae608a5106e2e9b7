"""MediaPipe's hand landmarks, from either of its interfaces, in our conventions.

Wheels up to 0.10.21 carry `solutions.hands` and its models; later ones have the Tasks API alone and take a
hand_landmarker.task from the user. Which hand the two call "Left" differs, and has changed between versions, so it is
asked of a picture of our own right hand. A frame's points depend on the pictures before: where a hand was found it is
looked for there first. That finds more (all of 100 frames of a hand that opens and closes before the camera, where
searching every picture anew finds 88), is twice as fast, and is the same in every run.
"""

import hashlib
import importlib
import os
import weakref
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8
from torch import Tensor

from torchhand.detect.landmarks import Landmarks
from torchhand.errors import InputError
from torchhand.files import HandDetection, models_dir, read_picture
from torchhand.files.disk import expanded
from torchhand.hand import Side

_KNOWN = "palm.png"
"""A right hand, in the folder of the model of which it is a picture."""
_ERRORS_ALONE = "2"  # of glog's levels
_STEP_MS = 33
"""From one picture to the next, for an interface that wants times; they change nothing."""


class MediaPipe:
    """MediaPipe as it is installed here."""

    def __init__(self, hand_model: Path | None = None) -> None:
        """hand_model: hand_landmarker.task; the wheel's own models are used without one.

        Raises InputError where MediaPipe is not installed, has no models of its own, or cannot read the given one.
        """
        package, self._model = _package(), None if hand_model is None else expanded(hand_model)
        version = str(getattr(package, "__version__", "of unknown version"))
        if self._model is None:
            if getattr(package, "solutions", None) is None:
                raise InputError(
                    f"mediapipe {version} carries no hand model: expected --hand-model with a hand_landmarker.task, or"
                    " mediapipe 0.10.21 or older"
                )
            self.name = f"mediapipe {version} solutions.hands"
        else:
            if not self._model.is_file():
                raise InputError(f"{self._model}: expected a hand_landmarker.task of MediaPipe, found no such file")
            self.name = f"mediapipe {version} {hashlib.sha256(self._model.read_bytes()).hexdigest()[:16]}"
        self._sides = _sides(self._model)

    def open(self, hands: int) -> Landmarks:
        """Landmarks of the hands, so many at most, of pictures that follow one another."""
        return _opened(self._model, hands, self._sides)


class _Solutions:
    """`solutions.hands`, full model."""

    def __init__(self, hands: int, sides: Mapping[str, Side]) -> None:
        self._sides = sides
        kind = _package().solutions.hands.Hands
        self._graph = kind(static_image_mode=False, max_num_hands=hands, model_complexity=1)

    def detect(self, image: UInt8[Tensor, "height width 3"]) -> Sequence[HandDetection]:
        found = self._graph.process(_array(image))
        lists = (found.multi_hand_landmarks, found.multi_hand_world_landmarks, found.multi_handedness)
        return [
            _detection(image, picture.landmark, space.landmark, self._sides.get(told.label), told.score)
            for picture, space, (told, *_) in zip(
                lists[0] or (), lists[1] or (), (one.classification for one in lists[2] or ()), strict=True
            )
        ]

    def close(self) -> None:
        self._graph.close()


class _Tasks:
    """The Tasks API's HandLandmarker in its mode for video, with a model from the user."""

    def __init__(self, model: Path, hands: int, sides: Mapping[str, Side]) -> None:
        """Raises InputError for a model that MediaPipe cannot read."""
        self._sides, self._time_ms = sides, 0
        package = _package()
        vision = package.tasks.vision
        options = vision.HandLandmarkerOptions(
            base_options=package.tasks.BaseOptions(model_asset_path=str(model)),
            running_mode=vision.RunningMode.VIDEO,
            num_hands=hands,
        )
        try:
            self._graph = vision.HandLandmarker.create_from_options(options)
        except (RuntimeError, ValueError, OSError) as error:
            reason = str(error).strip().partition("\n")[0]
            raise InputError(
                f"{model}: expected a hand_landmarker.task that mediapipe can read, got another file ({reason})"
            ) from error
        self._picture_of = package.Image, package.ImageFormat.SRGB

    def detect(self, image: UInt8[Tensor, "height width 3"]) -> Sequence[HandDetection]:
        make, colours = self._picture_of
        self._time_ms += _STEP_MS
        found = self._graph.detect_for_video(make(image_format=colours, data=_array(image)), self._time_ms)
        return [
            _detection(image, picture, space, self._sides.get(told.category_name), told.score)
            for picture, space, (told, *_) in zip(
                found.hand_landmarks, found.hand_world_landmarks, found.handedness, strict=True
            )
        ]

    def close(self) -> None:
        self._graph.close()


class _Closing:
    """Landmarks that are closed at the latest before the interpreter is taken down."""

    def __init__(self, landmarks: Landmarks) -> None:
        self.detect = landmarks.detect
        self.close = weakref.finalize(self, landmarks.close)


def _opened(model: Path | None, hands: int, sides: Mapping[str, Side]) -> Landmarks:
    return _Closing(_Solutions(hands, sides) if model is None else _Tasks(model, hands, sides))


@lru_cache(maxsize=8)
def _sides(model: Path | None) -> Mapping[str, Side]:
    """Which side is meant by each label in a picture that is not mirrored.

    Raises InputError where the model does not find the hand of the known picture.
    """
    known = read_picture(models_dir() / "generic_hand" / _KNOWN)
    named: dict[str, Side] = {"Left": "left", "Right": "right"}
    landmarks = _opened(model, 1, named)
    found = landmarks.detect(known)
    landmarks.close()
    if not found:
        name = "its own model" if model is None else str(model)
        raise InputError(f"mediapipe: expected a model of hands, got {name}, which finds none in a picture of a hand")
    return named if found[0].label == "right" else {"Left": "right", "Right": "left"}


def _detection(
    image: UInt8[Tensor, "height width 3"],
    picture: Sequence[Any],
    space: Sequence[Any],
    side: Side | None,
    score: float,
) -> HandDetection:
    height, width = image.shape[:2]
    return HandDetection(
        picture=np.array([(width * point.x - 0.5, height * point.y - 0.5) for point in picture]),
        space=np.array([(point.x, point.y, point.z) for point in space]),
        confidence=None,
        label=side,
        score=float(score),
    )


def _array(image: UInt8[Tensor, "height width 3"]) -> np.ndarray:
    return np.ascontiguousarray(image.cpu().numpy())


def _package() -> Any:
    """The package. Raises InputError where it cannot be had.

    It and TensorFlow Lite in it log to the terminal, at levels that they take from the environment when they are first
    loaded. Levels that the user has set stay.
    """
    for name in ("GLOG_minloglevel", "TF_CPP_MIN_LOG_LEVEL"):
        os.environ.setdefault(name, _ERRORS_ALONE)
    try:
        return importlib.import_module("mediapipe")
    except ImportError as error:
        raise InputError(
            f"mediapipe is not installed here ({error}): expected it for --keypoints mediapipe; pip install"
            " torchhand[mediapipe], or give a file of detected keypoints"
        ) from error
