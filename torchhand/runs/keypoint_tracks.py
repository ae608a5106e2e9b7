"""Keypoints that a detector found in a recording, read from files and handed out view by view and frame by frame."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch

from torchhand.errors import InputError
from torchhand.files import read_detections
from torchhand.geometry import Camera
from torchhand.hand import Side
from torchhand.track import HandKeypoints


@dataclass(frozen=True, kw_only=True)
class DetectionFiles:
    """Files of detected keypoints."""

    paths: tuple[Path, ...]
    """One per camera, in their order."""
    side: Side = "right"
    """Of the hand that is tracked; those of the other hand are left out."""


class KeypointTracks:
    """One file of detections per camera, in the cameras' order.

    A file may hold points in the picture, points in space up to a similarity (such as MediaPipe's world landmarks), or
    both; points in space alone cannot be used, as they do not tell where the hand is.
    """

    def __init__(self, files: DetectionFiles, cameras: Sequence[Camera]) -> None:
        """Raises InputError for files that cannot be read, that hold no points in the picture, or are not one a
        camera."""
        paths = files.paths
        if len(paths) != len(cameras):
            raise InputError(f"--keypoints: expected one file per camera, {len(cameras)}, got {len(paths)}")
        self._views = [_View(path, camera, files.side) for path, camera in zip(paths, cameras, strict=True)]

    def hand(self, view: int, frame: int) -> HandKeypoints | None:
        """What was found in a frame of a view; None where nothing was."""
        return self._views[view].hand(frame)


class _View:
    """The detections of one camera."""

    def __init__(self, path: Path, camera: Camera, side: Side) -> None:
        self._found = read_detections(path, side=side)
        if self._found.picture is None:
            raise InputError(f"{path}: expected points in the picture, got points in space alone")
        self._pixels = self._found.in_pixels(camera.width, camera.height)

    def hand(self, frame: int) -> HandKeypoints | None:
        seen, in_picture = self._found.at_frame(frame), self._pixels.at_frame(frame)
        if seen is None or in_picture is None or in_picture.picture is None or in_picture.confidence is None:
            return None
        points = torch.from_numpy(in_picture.picture)
        is_known = points.isfinite().all(-1)
        if not bool(is_known.any()):
            return None
        score = seen.score
        if math.isnan(score):  # of the hand, where the file tells; else the mean of its points
            score = float(torch.from_numpy(in_picture.confidence)[is_known].mean())
        space = None if seen.space is None else torch.from_numpy(seen.space)
        return HandKeypoints(points_px=points, points=space, score=score)
