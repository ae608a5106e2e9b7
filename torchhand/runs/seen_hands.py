"""Detections of files with their cameras: what a hand is fitted to."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from torchhand.errors import InputError
from torchhand.files import Detections, camera_for, camera_per_picture, load_cameras
from torchhand.fit.keypoints import SeenKeypoints
from torchhand.geometry import Camera


def cameras_of_detections(
    path: Path | None, size: tuple[int, int] | None, detections: Sequence[Detections]
) -> list[Camera]:
    """The camera of every file of detections: from a file of as many (cameras.json), or an .npz with one K per picture
    for one file of detections; of pictures of a size (px) with an assumed field of view where there is no file.

    Raises InputError for files that hold something else.
    """
    if path is None:
        assert size is not None
        return [camera_for(None, *size) for _ in detections]
    if path.suffix.lower() == ".npz":
        if len(detections) != 1:
            raise InputError(f"{path}: expected cameras of {len(detections)} files of keypoints, got one K per picture")
        found = detections[0]
        if found.is_normalised:
            raise InputError(f"{path}: expected points in px with one K per picture, got fractions of the picture")
        return [camera_per_picture(path, found.image, len(found), found.size)]
    cameras = load_cameras(path)
    if len(cameras) != len(detections):
        names = ", ".join(camera.name for camera in cameras)
        raise InputError(f"{path}: expected {len(detections)} cameras, one per file, got {len(cameras)} ({names})")
    return list(cameras)


def seen_keypoints(detections: Sequence[Detections], cameras: Sequence[Camera]) -> list[SeenKeypoints]:
    """What was seen by every camera, of the same frames each. Raises InputError where they differ."""
    seen = []
    for found, camera in zip(detections, cameras, strict=True):
        if not np.array_equal(found.frame, detections[0].frame):
            raise InputError(
                f"keypoints of several cameras: expected the same frames in each file, got {len(detections[0])} and"
                f" {len(found)} (of other numbers)"
            )
        pixels = found.in_pixels(camera.width, camera.height)
        assert pixels.picture is not None
        seen.append(
            SeenKeypoints(
                camera=camera,
                points_px=torch.from_numpy(pixels.picture),
                points=None if found.space is None else torch.from_numpy(found.space),
                confidence=torch.from_numpy(pixels.confidence),
                cov_px=None if found.cov_px is None else torch.from_numpy(found.cov_px),
            )
        )
    return seen
