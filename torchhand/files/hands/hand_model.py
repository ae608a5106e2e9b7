"""A model folder (models/generic_hand) parsed once into records."""

from functools import lru_cache
from pathlib import Path

import torch

from torchhand.errors import InputError
from torchhand.files.disk import models_dir, read_json, read_number, short
from torchhand.files.hands.mesh_file import load_mesh
from torchhand.files.hands.skeleton_file import load_skeleton
from torchhand.hand import HandModel, ShapeSpace

MESH_NAME = "mesh.npz"
_FIELDS = ("default", "lower", "upper", "std")


@lru_cache(maxsize=8)
def load_hand_model(name: str = "generic_hand") -> HandModel:
    """The model of that name among those shipped, or of a folder given by path; float64 records. A folder may lack a
    mesh; its model then has none.

    Raises InputError naming the file and what it lacks.
    """
    folder = Path(name) if Path(name).is_dir() else models_dir() / name
    if not folder.is_dir():
        known = ", ".join(sorted(entry.name for entry in models_dir().iterdir() if (entry / "hand.urdf").is_file()))
        raise InputError(f"hand model: expected a folder or one of {known}, got {name!r}")
    space, mesh_path = read_shape_space(folder / "shape.json"), folder / MESH_NAME
    return HandModel(
        name=folder.name,
        skeleton=load_skeleton(folder / "hand.urdf"),
        shape_space=space,
        mesh=load_mesh(mesh_path, shape_names=space.names) if mesh_path.exists() else None,
    )


def read_shape_space(path: Path) -> ShapeSpace:
    """The shape parameters of a model folder, float64."""
    content = read_json(path)
    table = content.get("parameters") if isinstance(content, dict) else None
    if not isinstance(table, list) or not all(isinstance(row, dict) for row in table):
        raise InputError(f"{path}: expected JSON with a list 'parameters' of entries, got {short(content)}")
    for field in ("name", "unit"):
        if not all(isinstance(row.get(field), str) for row in table):
            raise InputError(f"{path}: a parameter lacks a text {field!r}")
    columns = {}
    for field in _FIELDS:
        numbers = []
        for row in table:
            if field not in row:
                raise InputError(f"{path}: parameter {row['name']!r} lacks a number {field!r}")
            numbers.append(read_number(f"{path}: parameter {row['name']!r}: {field}", row[field]))
        columns[field] = torch.tensor(numbers, dtype=torch.float64)
    try:
        return ShapeSpace(
            names=tuple(row["name"] for row in table), units=tuple(row["unit"] for row in table), **columns
        )
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error
