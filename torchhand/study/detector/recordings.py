"""Recordings whose truth is known, with what a detector saw in them."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.errors import InputError
from torchhand.files import camera_per_picture, load_cameras, read_detections
from torchhand.files.disk import opened_arrays
from torchhand.geometry import Camera
from torchhand.hand import Side


@dataclass(frozen=True, kw_only=True)
class DetectedRecording:
    """The frames of one camera's recording in which the detector found the hand."""

    name: str
    side: Side
    camera: Camera
    """One, or one for each frame; in its own frame."""
    truth: Float[Tensor, "frames 21 3"]
    """True keypoints in the camera's frame, metres."""
    points_px: Float[Tensor, "frames 21 2"]
    """Detected points in the pictures."""
    points: Float[Tensor, "frames 21 3"]
    """Detected points in space, along the camera's axes."""

    def __len__(self) -> int:
        return len(self.truth)


def read_recordings(folder: Path) -> Iterator[DetectedRecording]:
    """The recordings of every camera of a folder: truth.npz with keypoints3d (and K per picture, where there is no
    cameras.json), and a detector's points in mediapipe.npz, or in mediapipe_view_0.npz and so on.

    Raises InputError naming the file and what is wrong with it.
    """
    with opened_arrays(folder / "truth.npz", complaint="expected an array file with keypoints3d") as stored:
        truth = stored.get("keypoints3d")
    if truth is None or truth.ndim != 3 or truth.shape[1:] != (21, 3):
        got = "none" if truth is None else truth.shape
        raise InputError(f"{folder / 'truth.npz'}: keypoints3d: expected an array (frames, 21, 3), got {got}")
    has_cameras = (folder / "cameras.json").is_file()
    cameras = load_cameras(folder / "cameras.json") if has_cameras else [None]
    single = len(cameras) == 1
    for view, camera in enumerate(cameras):
        path = folder / ("mediapipe.npz" if single else f"mediapipe_view_{view}.npz")
        name = folder.name if single else f"{folder.name}/{view}"
        yield _recording(name, path, torch.from_numpy(truth.astype(np.float64)), camera)


def _recording(name: str, path: Path, truth: Tensor, camera: Camera | None) -> DetectedRecording:
    seen = read_detections(path)
    if seen.picture is None or seen.space is None or seen.side is None:
        raise InputError(f"{path}: expected points in the picture and in space, and labels, got a part of these")
    if len(seen) != len(truth):
        raise InputError(f"{path}: expected {len(truth)} frames as in truth.npz, got {len(seen)}")
    if camera is None:
        camera = camera_per_picture(path.with_name("truth.npz"), seen.image, len(seen))
    points_px = torch.from_numpy(seen.in_pixels(camera.width, camera.height).keypoints)
    points, known = torch.from_numpy(seen.space), torch.from_numpy(np.isfinite(seen.space).all((1, 2)))
    known &= points_px.isfinite().all(-1).all(-1) & truth.isfinite().all(-1).all(-1)
    eye = torch.eye(3, dtype=torch.float64)
    own = replace(camera, rotation=eye.expand_as(camera.rotation), translation=torch.zeros_like(camera.translation))
    return DetectedRecording(
        name=name,
        side=seen.side,
        camera=own.rows(known.nonzero()[:, 0]),
        truth=camera.cam_from_world(truth)[known],
        points_px=points_px[known],
        points=points[known],
    )
