"""signs.json in a model's folder: the solved joint angles of the signs, degrees."""

import json
from pathlib import Path

import torch
from jaxtyping import Float64
from torch import Tensor

from torchhand.errors import InputError
from torchhand.files import models_dir
from torchhand.files.disk import read_json, read_numbers, short, write_text
from torchhand.hand import JOINT_DOFS

FORMAT = "torchhand signs 1"
SIGNS_NAME = "signs.json"
_DIGITS = 3


def save_signs(path: str | Path, signs: str, joints: Float64[Tensor, "signs 30"]) -> None:
    """Write the file; angles are given in radians and rounded to a thousandth of a degree."""
    rows = torch.rad2deg(joints).tolist()
    lines = [
        f"{json.dumps(sign)}: {json.dumps([round(a, _DIGITS) + 0.0 for a in row])}"
        for sign, row in zip(signs, rows, strict=True)
    ]
    names = json.dumps(list(JOINT_DOFS))
    body = ",\n    ".join(lines)
    write_text(
        Path(path),
        f'{{\n  "format": "{FORMAT}",\n  "unit": "deg",\n  "joints": {names},\n  "signs": {{\n    {body}\n  }}\n}}\n',
    )


def load_signs(path: str | Path | None = None) -> dict[str, Float64[Tensor, "30"]]:
    """Joint angles of every sign, radians; of the generic hand where no file is named.

    Raises InputError naming the file, the entry and what is wrong with it.
    """
    path = models_dir() / "generic_hand" / SIGNS_NAME if path is None else Path(path)
    record = read_json(path)
    if not isinstance(record, dict) or record.get("format") != FORMAT:
        got = record.get("format") if isinstance(record, dict) else record
        raise InputError(f"{path}: format: expected {FORMAT!r}, got {short(got)}")
    if record.get("joints") != list(JOINT_DOFS):
        raise InputError(f"{path}: joints: expected the {len(JOINT_DOFS)} joint angles in their order, got others")
    signs = record.get("signs")
    if not isinstance(signs, dict) or not signs:
        raise InputError(f"{path}: signs: expected an object of lists of angles, got {short(signs)}")
    return {
        sign: torch.deg2rad(
            torch.tensor(read_numbers(f"{path}: signs: {sign}", row, (len(JOINT_DOFS),)), dtype=torch.float64)
        )
        for sign, row in signs.items()
    }
