"""skeleton.npz beside a model's hand.urdf: what pytorch-kinematics read in it, so that commands start without that.

Importing that library takes 0.7 s, most of it matplotlib's, of every command and of `import torchhand` in use. The file
holds the SHA-256 of the hand.urdf that it was read from: one that was edited since is parsed anew.
"""

from dataclasses import fields
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchhand.errors import InputError
from torchhand.files.disk import opened_arrays, read_plain_file, replacing
from torchhand.files.hands.urdf import read_skeleton
from torchhand.hand import BONES, JOINT_DOFS, Skeleton

SKELETON_NAME = "skeleton.npz"
_NAMES = tuple(field.name for field in fields(Skeleton))
_SHAPES = {"rest_rotation": (len(BONES), 3, 3), "rest_offset": (len(BONES), 3), "tip_offset": (5, 3), "axis": (-1, 3)}
_LARGEST_URDF = 64 * 2**20


def save_parsed_skeleton(urdf: Path) -> Path:
    """Parse a hand.urdf and write what it says to skeleton.npz beside it; its path."""
    skeleton, path = read_skeleton(urdf), urdf.with_name(SKELETON_NAME)
    arrays: dict[str, Any] = {name: np.asarray(getattr(skeleton, name)) for name in _NAMES}
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez(file, urdf_sha256=np.array(_digest(urdf)), **arrays)
    return path


def load_skeleton(urdf: Path) -> Skeleton:
    """The skeleton of a model folder's hand.urdf, float64: from skeleton.npz where that was read from this very file,
    else parsed. Raises InputError naming the file that is wrong."""
    path = urdf.with_name(SKELETON_NAME)
    if not path.is_file():
        return read_skeleton(urdf)
    with opened_arrays(path, complaint="is no parsed skeleton that can be read") as stored:
        arrays = stored.chosen(("urdf_sha256", *_NAMES))
    if str(arrays.get("urdf_sha256")) != _digest(urdf):
        return read_skeleton(urdf)
    values: dict[str, Any] = {}
    for name in _NAMES:
        expected = tuple(len(JOINT_DOFS) if side < 0 else side for side in _SHAPES.get(name, (-1,)))
        is_index = name in ("bone", "order")
        array = arrays.get(name)
        if array is None or array.shape != expected or array.dtype.kind != ("i" if is_index else "f"):
            raise InputError(f"{path}: {name}: expected {'integers' if is_index else 'numbers'} of shape {expected}")
        values[name] = tuple(array.tolist()) if is_index else torch.from_numpy(array.astype(np.float64))
    if not all(bool(value.isfinite().all()) for value in values.values() if isinstance(value, Tensor)):
        raise InputError(f"{path}: expected finite numbers")
    return Skeleton(**values)


def _digest(urdf: Path) -> str:
    return sha256(read_plain_file(urdf, largest=_LARGEST_URDF)).hexdigest()
