"""mesh.npz of a model folder: the skinned mesh with the names that its indices and columns mean."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchhand.errors import InputError
from torchhand.files.disk import opened_arrays, replacing
from torchhand.hand import BONES, DOFS, JOINT_DOFS, HandMesh

MESH_FORMAT = "torchhand mesh 1"
_WEIGHT_TOLERANCE = 1e-4  # of the sum of a vertex's weights; float32 rounds at 1e-7
_FLOATS = {
    "vertices": ("vertices", 3),
    "shape_basis": ("vertices", 3, "shape parameters"),
    "skin_weights": ("vertices", 4),
    "bind_pose": (len(DOFS),),
    "corrective_basis": ("vertices", 3, "correctives", 2),
}
_INTEGERS = {"faces": ("faces", 3), "skin_bones": ("vertices", 4)}
_NAMES = ("shape_names", "bone_names", "dof_names", "corrective_dofs")


def save_mesh(mesh: HandMesh, path: str | Path, *, shape_names: Sequence[str]) -> None:
    """Write a mesh, floats as float32; the same mesh gives the same bytes.

    shape_names: the parameters that the columns of `shape_basis` mean, in their order.
    """
    if len(shape_names) != mesh.shape_basis.shape[-1]:
        raise ValueError(
            f"shape_names: expected {mesh.shape_basis.shape[-1]}, one per column of shape_basis, got {len(shape_names)}"
        )
    arrays: dict[str, Any] = {"format": np.array(MESH_FORMAT)}
    arrays |= {name: getattr(mesh, name).detach().cpu().numpy().astype(np.float32) for name in _FLOATS}
    arrays |= {name: getattr(mesh, name).cpu().numpy().astype(np.int32) for name in _INTEGERS}
    arrays["corrective_dofs"] = np.array([JOINT_DOFS[dof] for dof in mesh.corrective_dofs], dtype=np.str_)
    arrays |= {"shape_names": np.array(shape_names), "bone_names": np.array(BONES), "dof_names": np.array(DOFS)}
    with replacing(Path(path)) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)


def load_mesh(path: str | Path, *, shape_names: Sequence[str]) -> HandMesh:
    """The mesh in a file, float64; its names must be the skeleton's and those of the shape parameters, in their order.

    Raises InputError naming the file, the array and what is wrong with it.
    """
    path = Path(path)
    arrays = _read(path)
    sizes: dict[str, int] = {"shape parameters": len(shape_names)}
    expected_names = {"shape_names": tuple(shape_names), "bone_names": BONES, "dof_names": DOFS}
    for name, expected in expected_names.items():
        _check_names(f"{path}: {name}", arrays[name], expected)
    corrective_names = [str(name) for name in arrays["corrective_dofs"].reshape(-1)]
    if unknown := [name for name in corrective_names if name not in JOINT_DOFS]:
        raise InputError(f"{path}: corrective_dofs: expected joint angles, got {unknown[0]!r}")
    sizes["correctives"] = len(corrective_names)
    for name, dims in (_FLOATS | _INTEGERS).items():
        _check_array(f"{path}: {name}", arrays[name], dims, sizes, kind="f" if name in _FLOATS else "iu")
    for name, maximum in (("faces", sizes["vertices"]), ("skin_bones", len(BONES))):
        if arrays[name].size and not 0 <= arrays[name].min() <= arrays[name].max() < maximum:
            raise InputError(f"{path}: {name}: expected indices from 0 to {maximum - 1}, got others")
    weights = torch.from_numpy(arrays["skin_weights"].astype(np.float64))
    total = weights.sum(-1, keepdim=True)
    if bool((weights < 0).any()) or bool(((total - 1).abs() > _WEIGHT_TOLERANCE).any()):
        raise InputError(f"{path}: skin_weights: expected weights of at least 0 that sum to 1 at every vertex")
    tensors = {name: torch.from_numpy(arrays[name].astype(np.float64)) for name in _FLOATS}
    tensors |= {name: torch.from_numpy(arrays[name].astype(np.int64)) for name in _INTEGERS}
    tensors["skin_weights"] = weights / total
    return HandMesh(corrective_dofs=tuple(JOINT_DOFS.index(name) for name in corrective_names), **tensors)


def _read(path: Path) -> dict[str, np.ndarray]:
    with opened_arrays(path, complaint="is no mesh that can be read") as stored:
        arrays = stored.chosen(("format", *_FLOATS, *_INTEGERS, *_NAMES))
    if "format" not in arrays or str(arrays["format"]) != MESH_FORMAT:
        got = repr(str(arrays["format"]))[:60] if "format" in arrays else "a file without 'format'"
        raise InputError(f"{path}: expected a mesh ('format': '{MESH_FORMAT}'), got {got}")
    if missing := [name for name in (*_FLOATS, *_INTEGERS, *_NAMES) if name not in arrays]:
        raise InputError(f"{path}: lacks {', '.join(missing)}")
    return arrays


def _check_names(what: str, got: np.ndarray, expected: Sequence[str]) -> None:
    names = [str(name) for name in got.reshape(-1)]
    if len(names) != len(expected):
        raise InputError(f"{what}: expected {len(expected)} names, got {len(names)}")
    for place, (name, wanted) in enumerate(zip(names, expected, strict=True)):
        if name != wanted:
            raise InputError(f"{what}: expected {wanted!r} at place {place}, got {name!r}")


def _check_array(
    what: str, array: np.ndarray, dims: tuple[int | str, ...], sizes: dict[str, int], *, kind: str
) -> None:
    """The array has this kind of numbers and these dimensions; a named one is fixed where it is first met."""
    if array.dtype.kind not in kind:
        wanted = "floating-point numbers" if kind == "f" else "whole numbers"
        raise InputError(f"{what}: expected {wanted}, got {array.dtype}")
    matches = array.ndim == len(dims)
    if matches:
        for dim, size in zip(dims, array.shape, strict=True):
            matches &= size == (sizes.setdefault(dim, size) if isinstance(dim, str) else dim)
    if not matches or (array.ndim > 1 and len(array) == 0):
        wanted = ", ".join(str(sizes.get(dim, dim)) if isinstance(dim, str) else str(dim) for dim in dims)
        raise InputError(f"{what}: expected the dimensions ({wanted}), got {array.shape}")
    if kind == "f" and not np.isfinite(array).all():
        raise InputError(f"{what}: expected finite numbers, got NaN or infinite ones")
