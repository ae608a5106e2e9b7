"""Keypoints that a detector found in a recording, read from files and handed out view by view and frame by frame."""

from collections.abc import Sequence
from pathlib import Path

import torch

from torchhand.errors import InputError
from torchhand.files import Detections, read_detections
from torchhand.geometry import Camera
from torchhand.hand import Side
from torchhand.track import DetectedHand


class KeypointTracks:
    """One file of detections per camera, in the cameras' order.

    A file may hold points in the picture, points in space up to a similarity (such as MediaPipe's world landmarks), or
    both; points in space alone cannot be used, as they do not tell where the hand is.
    """

    def __init__(self, paths: Sequence[Path], cameras: Sequence[Camera], side: Side) -> None:
        """Raises InputError for files that cannot be read, that hold no points in the picture, or are not one a
        camera."""
        if len(paths) != len(cameras):
            raise InputError(f"--keypoints: expected one file per camera, {len(cameras)}, got {len(paths)}")
        self._views = [_View(path, camera, side) for path, camera in zip(paths, cameras, strict=True)]

    def hand(self, view: int, frame: int) -> DetectedHand | None:
        """What was found in a frame of a view; None where nothing was."""
        return self._views[view].hand(frame)


class _View:
    """The detections of one camera."""

    def __init__(self, path: Path, camera: Camera, side: Side) -> None:
        picture = read_detections(path, side=side, points="picture")
        if picture.units == "metres":
            raise InputError(f"{path}: expected points in the picture, got points in space alone")
        self._picture = picture.in_pixels(camera.width, camera.height)
        self._space = _space_of(path, side)
        self._rows = {int(number): row for row, number in enumerate(self._picture.frame)}
        self._space_rows = {} if self._space is None else {int(n): row for row, n in enumerate(self._space.frame)}

    def hand(self, frame: int) -> DetectedHand | None:
        row = self._rows.get(frame)
        if row is None:
            return None
        points = torch.from_numpy(self._picture.keypoints[row])
        is_known = points.isfinite().all(-1)
        if not bool(is_known.any()):
            return None
        confidence = torch.from_numpy(self._picture.confidence[row])
        space, place = self._space, self._space_rows.get(frame)
        in_space = None if space is None or place is None else torch.from_numpy(space.keypoints[place])
        return DetectedHand(points_px=points, points=in_space, score=float(confidence[is_known].mean()))


def _space_of(path: Path, side: Side) -> Detections | None:
    """Points in space, where the file holds some."""
    try:
        found = read_detections(path, side=side, points="space")
    except InputError:
        return None
    return found if found.units == "metres" else None
