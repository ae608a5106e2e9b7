"""A folder of single pictures with true keypoints: truth.npz with the cameras and the 21 points of each."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.errors import InputError
from torchhand.files.disk import opened_arrays

TRUTH_NAME = "truth.npz"
SHAPES = {"K": (3, 3), "keypoints3d": (21, 3)}


@dataclass(frozen=True, kw_only=True)
class Stills:
    """Hands in the frames of their cameras, which have no lens distortion."""

    names: tuple[str, ...]
    """Names of the pictures."""
    intrinsics: Float[Tensor, "pictures 3 3"]
    keypoints: Float[Tensor, "pictures 21 3"]
    """Keypoints, metres."""

    @property
    def points_plane(self) -> Float[Tensor, "pictures 21 2"]:
        """Points on the normalised image plane."""
        return self.keypoints[..., :2] / self.keypoints[..., 2:]

    @property
    def points_px(self) -> Float[Tensor, "pictures 21 2"]:
        """Where the true keypoints appear."""
        rays = torch.cat((self.points_plane, torch.ones_like(self.keypoints[..., :1])), -1)
        return (rays @ self.intrinsics.mT)[..., :2]


def load_stills(folder: Path) -> Stills:
    """Read `truth.npz` of a folder: image (N,) names, K (N, 3, 3), keypoints3d (N, 21, 3) metres, camera frame.

    Raises:
        InputError: no such file, no npz file, a key is missing, wrong shapes, numbers that are not finite, or a hand
            that is not in front of its camera.
    """
    file = folder / TRUTH_NAME
    if not file.is_file():
        raise InputError(f"{folder}: expected a folder with {TRUTH_NAME}; there is none")
    arrays = _arrays(file)
    count = len(arrays["image"])
    for key, size in SHAPES.items():
        array, wanted = arrays[key], (count, *size)
        if array.shape != wanted or not np.issubdtype(array.dtype, np.number) or not np.isfinite(array).all():
            raise InputError(
                f"{file}: {key}: expected finite numbers of shape {wanted}, got {array.dtype} {array.shape}"
            )
    if count == 0:
        raise InputError(f"{file}: expected at least one picture, got none")
    depth = arrays["keypoints3d"][..., 2]
    if depth.min() <= 0:
        raise InputError(f"{file}: keypoints3d: expected points before the camera (z above 0), got z {depth.min():g}")
    tensors = {key: torch.from_numpy(arrays[key].astype(np.float64)) for key in SHAPES}
    names = tuple(str(name) for name in arrays["image"])
    return Stills(names=names, intrinsics=tensors["K"], keypoints=tensors["keypoints3d"])


def _arrays(file: Path) -> dict[str, np.ndarray]:
    wanted = ("image", *SHAPES)
    complaint = f"expected an npz file with {', '.join(wanted)}; it cannot be read as one"
    with opened_arrays(file, complaint=complaint) as stored:
        given = list(stored)
        arrays = {key: np.asarray(stored[key]) for key in wanted if key in given}
    for key in wanted:
        if key not in arrays:
            raise InputError(f"{file}: expected the array {key!r}; got {', '.join(given) or 'none'}")
    if arrays["image"].ndim != 1:
        raise InputError(f"{file}: image: expected a list of names, got an array of shape {arrays['image'].shape}")
    return arrays
