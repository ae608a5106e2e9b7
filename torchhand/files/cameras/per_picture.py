"""Intrinsics of single pictures, each with its own, as arrays."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from torchhand.errors import InputError
from torchhand.files.disk import opened_arrays
from torchhand.geometry import Camera, assumed_camera


def camera_per_picture(
    path: Path, images: Sequence[str] | None, count: int, size: tuple[int, int] | None = None
) -> Camera:
    """A batch of cameras, one per picture, from an .npz with their intrinsics K (pictures, 3, 3), px.

    images: names of the pictures, by which rows are chosen where the file has names too (`image`); else rows are in the
    pictures' order and as many as these (count). size: width and height of the pictures, px, where they are known.

    Raises InputError naming the file and what is wrong with it.
    """
    with opened_arrays(path, complaint="expected an array file with intrinsics K that can be read") as stored:
        arrays = {name: stored[name] for name in ("K", "image") if name in stored}
    given, names = arrays.get("K"), arrays.get("image")
    if given is None or given.ndim != 3 or given.shape[1:] != (3, 3) or not np.issubdtype(given.dtype, np.number):
        got = "none" if given is None else f"{given.dtype} of {given.shape}"
        raise InputError(f"{path}: K: expected intrinsics of shape (pictures, 3, 3), got {got}")
    if names is not None and images is not None:
        if names.shape != (len(given),):
            raise InputError(f"{path}: image: expected {len(given)} names, got an array of shape {names.shape}")
        rows = {str(name): row for row, name in enumerate(names)}
        missing = [name for name in images if name not in rows]
        if missing:
            raise InputError(f"{path}: image: expected the name {missing[0]} among the pictures', it is not there")
        given = given[[rows[name] for name in images]]
    if len(given) != count:
        raise InputError(f"{path}: K: expected intrinsics of {count} pictures, got {len(given)}")
    matrices = torch.from_numpy(given.astype(np.float64))
    is_good = matrices.isfinite().all((-2, -1)) & (matrices[:, 0, 0] > 0) & (matrices[:, 1, 1] > 0)
    is_good &= (matrices[:, 1, 0] == 0) & (matrices[:, 2] == matrices.new_tensor((0.0, 0.0, 1.0))).all(-1)
    if not bool(is_good.all()):
        row = int((~is_good).nonzero()[0, 0])
        raise InputError(f"{path}: K[{row}]: expected [[fx, s, cx], [0, fy, cy], [0, 0, 1]], got {given[row].tolist()}")
    one = assumed_camera(*(size or (1, 1)))
    return replace(
        one,
        intrinsics=matrices,
        rotation=one.rotation.expand(count, 3, 3),
        translation=one.translation.expand(count, 3),
        distortion=one.distortion.expand(count, -1),
        is_assumed=False,
    )
