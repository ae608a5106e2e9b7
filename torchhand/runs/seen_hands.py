"""Detections of files with their cameras: what a hand is fitted to."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from torchhand.errors import InputError
from torchhand.files import Detections, camera_for, camera_per_picture, load_cameras, load_rig
from torchhand.files.rigs import UNITS
from torchhand.fit.keypoints import SeenKeypoints, triangulated
from torchhand.geometry import Camera

PALM_METRES = (0.03, 0.2)
"""Distances from the wrist to the middle knuckle that a hand may have."""

_BEYOND = 1.0
"""Sizes of the picture by which a point that one camera's detector guesses may lie outside it; the hand is in part
inside. MediaPipe's of `open_hand_wave` lie up to 0.18 outside, where the arm leaves the picture."""


def cameras_of_detections(
    path: Path | None,
    size: tuple[int, int] | None,
    detections: Sequence[Detections],
    *,
    unit: str | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> list[Camera]:
    """The camera of every view's detections: from a calibration of as many (`load_rig`), or an .npz with one K per
    picture for one view; of pictures of a size (px) with an assumed field of view where there is no file.

    unit: of the cameras' places. Without it metres are expected; where the hand would then be no hand's size, the unit
    is taken that makes it one, which is said.

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
    is_plain = path.suffix.lower() == ".json" and unit is None
    cameras = load_cameras(path) if is_plain else load_rig(path, unit=1.0 if unit is None else unit)
    if len(cameras) != len(detections):
        names = ", ".join(camera.name for camera in cameras)
        raise InputError(f"{path}: expected {len(detections)} cameras, one per view, got {len(cameras)} ({names})")
    if unit is not None or len(cameras) < 2:
        return list(cameras)
    factor = _metres_per_unit(path, cameras, detections, say)
    return [replace(camera, translation=factor * camera.translation) for camera in cameras]


def _metres_per_unit(
    path: Path, cameras: Sequence[Camera], detections: Sequence[Detections], say: Callable[[str], None]
) -> float:
    """1 where a hand of a hand's size is seen, or nothing is; else that of the unit that makes it one."""
    found = triangulated(cameras, [view.points_px for view in seen_keypoints(detections, cameras)]).points
    palm = float((found[:, 9] - found[:, 0]).norm(dim=-1).nanmedian())
    if not math.isfinite(palm) or PALM_METRES[0] <= palm <= PALM_METRES[1]:
        return 1.0
    fits = [name for name, factor in UNITS.items() if PALM_METRES[0] <= factor * palm <= PALM_METRES[1]]
    if len(fits) != 1:
        raise InputError(
            f"{path}: expected metres, but the palm would be {palm:.4g} long;"
            f" give --unit ({', '.join(UNITS)}, or a number of metres)"
        )
    say(f"{path}: the cameras' places are taken in {fits[0]}: the palm is {1000 * UNITS[fits[0]] * palm:.0f} mm long")
    return UNITS[fits[0]]


def same_frames(detections: Sequence[Detections]) -> list[Detections]:
    """Views with the frames of all, in the order of their numbers; a frame that a view lacks shows nothing there."""
    if all(np.array_equal(found.frame, detections[0].frame) for found in detections):
        return list(detections)
    numbers = np.unique(np.concatenate([found.frame for found in detections]))
    return [found.of_frames(numbers) for found in detections]


def seen_keypoints(detections: Sequence[Detections], cameras: Sequence[Camera]) -> list[SeenKeypoints]:
    """What was seen by every camera, of the same frames each (`same_frames`), without points that lie too far outside
    its pictures: by more than their size before one camera, at all before several."""
    beyond = _BEYOND if len(cameras) == 1 else 0.0  # other cameras know better than a detector that guesses
    seen = []
    for found, camera in zip(detections, cameras, strict=True):
        pixels = found.in_pixels(camera.width, camera.height)
        assert pixels.picture is not None
        points = torch.from_numpy(pixels.picture)
        if camera.intrinsics.ndim == 2 or found.size is not None:  # one K per picture tells no size
            size = points.new_tensor((camera.width, camera.height))
            is_outside = (points < -0.5 - beyond * size) | (points > (1 + beyond) * size - 0.5)
            points = torch.where(is_outside.any(-1, keepdim=True), torch.nan, points)
        seen.append(
            SeenKeypoints(
                camera=camera,
                points_px=points,
                points=None if found.space is None else torch.from_numpy(found.space),
                confidence=torch.from_numpy(pixels.confidence),
                cov_px=None if found.cov_px is None else torch.from_numpy(found.cov_px),
            )
        )
    return seen
