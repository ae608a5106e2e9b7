"""What a tracking run is asked for, read from texts and files and checked before anything starts."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from math import hypot, isfinite
from pathlib import Path
from typing import Any

import torch

from torchhand.detect import HandDetector
from torchhand.devices import HOST
from torchhand.errors import InputError
from torchhand.export import MAX_GAP_S
from torchhand.files import (
    FittedHand,
    Offsets,
    find_config,
    load_hand,
    load_hand_model,
    load_settings,
    read_picture,
    setting_in,
)
from torchhand.fit.detect import StartPoints
from torchhand.geometry import Camera
from torchhand.hand import Side
from torchhand.image import BackgroundPlate, learn_background
from torchhand.runs.changes import changes_of
from torchhand.runs.keypoint_tracks import KeypointTracks
from torchhand.runs.recordings import Recording
from torchhand.runs.side import HandsOfSide, find_side
from torchhand.track import DEFAULTS, TrackerSettings

MIN_START_SPAN_PX = 10.0
MEDIAPIPE = "mediapipe"
"""In place of a file of keypoints: the detector runs along."""


@dataclass(frozen=True, kw_only=True)
class Request:
    """What a run is asked for, whatever its input is."""

    settings: TrackerSettings
    config: str
    """Name of the configuration, as the user gave it."""
    side: Side | None = None
    """Which hand; None where it is to be found out (`with_side`)."""
    side_source: str = "given"
    """How the side is known, for the saved configuration."""
    hand: FittedHand | None = None
    """A known shape, which is then not fitted."""
    camera: Path | None = None
    """Calibration of the camera, or of the rig where that is not in its folder."""
    keypoints: tuple[Path, ...] = ()
    """Files of detected keypoints, one per camera; none where none are used."""
    has_detector: bool = False
    """Whether MediaPipe runs along, in place of files."""
    hand_model: Path | None = None
    """MediaPipe's hand_landmarker.task; its own models where none is given."""
    background: Path | None = None
    """Picture of the empty scene, or folder of one per camera."""
    start_points: StartPoints | None = None
    """One camera: wrist and middle fingertip in the first picture."""
    unit: str | None = None
    """Rig: what the cameras' translations are in; `hand`: to be fitted."""
    masks: bool | None = None
    """Rig: whether silhouettes are given; where it holds them if None."""
    offsets: Offsets = field(default_factory=dict)
    """Rig: frames, or seconds, by which cameras started before the others, by name."""
    is_causal: bool = False
    """Whether every frame is estimated from this and earlier ones alone."""
    is_live: bool = False
    """One camera: whether the newest picture is taken each time, and the others are dropped."""
    page_port: int | None = None
    """One camera, live: where a page shows what is tracked; None for none."""
    streams: tuple[str, ...] = ()
    """One camera: where estimates go while they are made (`torchhand.runs.streams`)."""
    max_gap_s: float = MAX_GAP_S
    """One camera: longest time without pictures that a pose stream fills with held poses, seconds."""
    start: int = 0
    max_frames: int | None = None
    resume: bool = False
    overwrite: bool = False
    keeps_checkpoint: bool = False
    """Whether a run that has ended well keeps what a longer one would go on from."""
    has_overlay: bool = True
    has_report: bool = True
    seed: int = 0
    workers: int = 1
    """Processes that share what can be worked on side by side."""
    device: torch.device = HOST
    """Device of the tracker; decoding and drawing are the processor's."""

    def with_side(
        self, recording: Recording, say: Callable[[str], None], trial: HandsOfSide | None = None
    ) -> "Request":
        """The request with a side: the one given, that of the known hand, or the one that the recording shows.

        trial: tells hands of both sides apart where nothing else does."""
        if self.side_source == "tried":
            return self
        known: Side | None = None if self.hand is None else ("left" if self.hand.side == "left" else "right")
        found = find_side(
            self.side or known,
            recording,
            keypoints=self.keypoints,
            has_detector=self.has_detector,
            hand_model=self.hand_model,
            trial=trial,
            device=self.device,
        )
        for line in found.notes():
            say(line)
        return replace(self, side=found.side, side_source=found.source)

    def causal(self) -> "Request":
        """The request without anything that corrects earlier frames."""
        return replace(self, is_causal=True, settings=replace(self.settings, smoothing_window_s=0.0))

    @property
    def known_side(self) -> Side:
        """The side; right where it has not been found out."""
        return self.side or "right"

    def keypoint_tracks(self, cameras: Sequence[Camera]) -> KeypointTracks | None:
        """What the files of keypoints hold of the hand; None where none are used."""
        if not self.keypoints:
            return None
        return KeypointTracks(self.keypoints, cameras, side=self.known_side, start=self.start)

    def detectors(self, cameras: Sequence[Camera]) -> list[HandDetector]:
        """A detector per camera; none where none runs along. Raises InputError where it cannot be had."""
        return (
            [HandDetector(side=self.known_side, hand_model=self.hand_model) for _ in cameras]
            if self.has_detector
            else []
        )


def keypoints_of(texts: Sequence[str], hand_model: Path | None) -> dict[str, Any]:
    """The fields of a request for keypoints: `mediapipe` alone, or files. Raises InputError for both, and for a model
    without mediapipe."""
    has_detector = MEDIAPIPE in texts
    if has_detector and len(texts) > 1:
        given = ", ".join(texts)
        raise InputError(f"--keypoints: expected {MEDIAPIPE} alone (for all cameras) or files, got {given}")
    if hand_model is not None and not has_detector:
        raise InputError(f"--hand-model: expected --keypoints {MEDIAPIPE} with it")
    paths = () if has_detector else tuple(Path(text) for text in texts)
    return {"keypoints": paths, "has_detector": has_detector, "hand_model": hand_model}


def settings_of(config: str, changes: Sequence[str] = (), posture: str | None = None) -> TrackerSettings:
    """The settings of a configuration with single fields changed.

    Raises InputError naming the file or the option and the key.
    """
    overrides = changes_of(changes, "noise.rotation=80")
    if posture is not None:
        if any(key.split(".")[0] == "posture" for key in overrides):
            raise InputError("--set: expected each field once, got posture and --posture")
        overrides["posture"] = posture
    path = find_config(config)
    method = overrides.get("method", setting_in(path, "method"))
    if method is not None and not (isinstance(method, str) and method in DEFAULTS):
        place = "--set" if "method" in overrides else path
        raise InputError(f"{place}: method: expected one of {', '.join(DEFAULTS)}, got {method!r}")
    return load_settings(DEFAULTS[method or "contour"], path, overrides | ({"method": method} if method else {}))


def known_hand(path: Path) -> FittedHand:
    """A shape from a file, checked against what a hand can be."""
    space = load_hand_model().shape_space
    hand = load_hand(path, space.names)
    for name, low, high in zip(space.names, space.lower.tolist(), space.upper.tolist(), strict=True):
        if not low <= hand.values[name] <= high:
            raise InputError(f"{path}: shape.{name}: expected {low:g} to {high:g}, got {hand.values[name]:g}")
    return hand


def plate_of(picture: Path | None, method: str, width: int, height: int) -> BackgroundPlate | None:
    """The plate of the empty scene where the settings' method asks for one.

    Raises InputError where it is missing, not asked for, unreadable or of another size than the pictures.
    """
    if method != "background":
        if picture is not None:
            raise InputError(
                f"--background: expected --set silhouette.method=background with it, got method {method!r}"
            )
        return None
    if picture is None:
        raise InputError(
            "silhouette.method background: expected --background with a picture of the empty scene, got none"
        )
    image = read_picture(picture)
    if image.shape[:2] != (height, width):
        got = f"{image.shape[1]}x{image.shape[0]}"
        raise InputError(f"{picture}: expected a picture of {width}x{height} px, the size of the others, got {got}")
    return learn_background(image[None])


def start_points_of(text: str) -> StartPoints:
    """The points of `WX,WY,MX,MY`, px. Raises InputError where the text is anything else."""
    try:
        wrist_x, wrist_y, tip_x, tip_y = (float(number) for number in text.split(","))
    except ValueError:
        raise InputError(
            "--start-points: expected 4 numbers WX,WY,MX,MY (wrist and middle fingertip, px) without spaces,"
            f" got {text!r}"
        ) from None
    if not all(map(isfinite, (wrist_x, wrist_y, tip_x, tip_y))):
        raise InputError(f"--start-points: expected 4 finite numbers, got {text!r}")
    return wrist_x, wrist_y, tip_x, tip_y


def check_start_points(points: StartPoints | None, width: int, height: int) -> None:
    """Raise InputError where the points cannot be those of a hand in a picture of that size."""
    if points is None:
        return
    for name, x, y in (("wrist", *points[:2]), ("middle fingertip", *points[2:])):
        if not (0 <= x <= width - 1 and 0 <= y <= height - 1):
            raise InputError(
                f"--start-points: {name}: expected a point in the picture, 0 to {width - 1}, 0 to {height - 1},"
                f" got {x:g}, {y:g}"
            )
    span = hypot(points[2] - points[0], points[3] - points[1])
    if span < MIN_START_SPAN_PX:
        raise InputError(
            f"--start-points: expected wrist and middle fingertip at least {MIN_START_SPAN_PX:g} px apart,"
            f" got {span:g} px"
        )
