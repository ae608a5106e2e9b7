"""The short way: the estimates of a recording, and the hand of a photograph, in one call without a result folder."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.detect import HandDetector
from torchhand.errors import InputError, require_kind
from torchhand.files import camera_for, load_hand_model
from torchhand.files.pictures import is_stream, named_picture
from torchhand.fit.open_hand import OpenHand, fit_open_hand, hand_in_picture
from torchhand.geometry import Camera
from torchhand.hand import Side
from torchhand.image import NoRegions
from torchhand.runs.detected_tracks import DetectedTracks
from torchhand.runs.keypoint_tracks import KeypointSource, KeypointTracks, with_keypoints
from torchhand.runs.recordings import LiveCamera, OneCameraRecording
from torchhand.runs.request import MEDIAPIPE, settings_of
from torchhand.runs.side import find_side
from torchhand.track import Estimate, Tracker, TrackerSettings, opened_tracker


def track(
    source: str | Path | int,
    *,
    side: Side | None = None,
    camera: Camera | str | Path | None = None,
    shape: Float[Tensor, "shape"] | None = None,
    settings: TrackerSettings | None = None,
    keypoints: str | Path | Literal["mediapipe"] | None = None,
    hand_model: str | Path | None = None,
) -> Iterator[Estimate]:
    """The estimates of one camera's recording, one per frame, as they are made; poses in the camera's frame.

    source: a video, a folder of pictures, the address of a stream, or the number of a webcam, whose newest picture is
    taken each time. side: found out from the keypoints where none is given, right without any. camera: its calibration,
    or a file of it; else a field of view is assumed. shape: proportions where they are known, such as those of
    `fit_hand`; else they are fitted. settings: those of the configuration contour_full where none are given. keypoints:
    a file of a detector's points, or MediaPipe itself, with hand_model (hand_landmarker.task) where it has none of its
    own. Causal: every estimate is made from its frame and earlier ones alone; `torchhand track` corrects those of a
    recording backwards, and keeps the result.

    Raises InputError for a source, a camera or keypoints that cannot be read, and for a camera of other pictures;
    TypeError for what is no camera and no file, ValueError for a shape outside its bounds; all of them with the first
    estimate.
    """
    require_kind("source", source, str, PathLike, int)
    if keypoints is not None:
        require_kind("keypoints", keypoints, str, PathLike)
    hand_model = None if hand_model is None else Path(hand_model)
    if isinstance(source, int):
        recording = LiveCamera(str(source), camera)
    else:
        recording = OneCameraRecording(str(source) if is_stream(source) else Path(source), camera)
    try:
        has_detector = keypoints == MEDIAPIPE
        files = [] if keypoints is None or has_detector else [Path(keypoints)]
        side = find_side(side, recording, keypoints=files, has_detector=has_detector, hand_model=hand_model).side
        hand = load_hand_model().hand(side=side, dtype=torch.float64)
        seen: KeypointSource | None = None
        if has_detector:
            seen = DetectedTracks([HandDetector(side=side, hand_model=hand_model)])
        elif files:
            seen = KeypointTracks(files, recording.cameras, side=side)
        settings = settings or settings_of("contour_full")
        make = partial(Tracker, hand, recording.cameras, settings, shape=shape)
        state, followed_px = None, None
        with opened_tracker(make, waits=not recording.is_live) as (tracker, beside), recording.opened(0) as frames:
            step = tracker.step if beside is None else beside.step
            for frame in frames:
                views = with_keypoints(frame, seen, followed_px).views
                state, estimate = step(state, views, frame.time_s)
                followed_px = followed_px if estimate.keypoints_px is None else estimate.keypoints_px
                yield estimate
    finally:
        recording.close()


def fit_hand(
    picture: str | Path | Tensor | np.ndarray,
    *,
    side: Side = "right",
    camera: Camera | str | Path | None = None,
) -> OpenHand:
    """Proportions and pose of the open hand in one picture, with their standard deviations.

    picture: a file, or RGB as uint8 (height, width, 3). One picture does not tell how large a hand is: its length is
    that of the average hand (`torchhand.fit.open_hand` has other sizes). camera: in whose frame the pose is, or a file
    of its calibration; a field of view is assumed where none is given.

    Raises InputError where the picture shows no open hand, or not all five fingers, for what is no picture, and for a
    camera of others; TypeError for what is no camera and no file.
    """
    name, image = named_picture(picture)
    camera = camera_for(camera, image.shape[1], image.shape[0])
    seen = hand_in_picture(image)
    found = seen.silhouette
    if not bool(found.mask.any()):
        raise InputError(f"{name}: no hand: nothing of a hand's size stands out by colour or brightness")
    if found.odd_digits:
        raise InputError(f"{name}: {', '.join(found.odd_digits)} of another colour than the palm")
    kinematics = load_hand_model().kinematics(side, dtype=torch.float64)
    hand = fit_open_hand(found.mask, kinematics, seen.camera(camera))
    if isinstance(hand, NoRegions):
        raise InputError(f"{name}: {hand.reason}")
    return replace(hand, part=seen.part)
