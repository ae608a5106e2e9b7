"""The motion of a URDF hand as a table: the wrist's pose and every joint's angle, written and read.

A line per frame: frame, time_s, held, side, x, y, z (metres), qx, qy, qz, qw, then the 30 joints of the URDF by name,
radians. Frame: that of the poses (a camera's: OpenCV) unless other axes are asked for.
"""

import csv
from itertools import pairwise
from pathlib import Path

import torch
from jaxtyping import Float64
from torch import Tensor

from torchhand.errors import InputError
from torchhand.export.clip import MotionClip
from torchhand.files.disk import finite, read_lines_of, short, whole, write_text
from torchhand.geometry import (
    continuous,
    quaternion_of_rotation,
    rotation_from_vector,
    rotation_of_quaternion,
    vector_from_rotation,
)
from torchhand.hand import JOINT_DOFS, HandModel

JOINTS_SUFFIX = ".joints.csv"
_ROOT = ("x", "y", "z", "qx", "qy", "qz", "qw")
_COLUMNS = ("frame", "time_s", "held", "side", *_ROOT, *JOINT_DOFS)


def write_joints(clip: MotionClip, path: str | Path) -> None:
    """Write the file."""
    placed = clip.placed("camera")
    quaternions = continuous(quaternion_of_rotation(rotation_from_vector(placed.poses[:, 3:6])))
    rows = torch.cat((placed.poses[:, :3], quaternions, placed.poses[:, -len(JOINT_DOFS) :]), 1).tolist()
    lines = [",".join(_COLUMNS)]
    for number, second, is_own, row in zip(clip.frame, clip.seconds.tolist(), clip.is_own, rows, strict=True):
        cells = (str(number), repr(second), str(int(not is_own)), clip.side, *map(repr, row))
        lines.append(",".join(cells))
    write_text(Path(path), "\n".join(lines) + "\n")


def clip_of_joints(path: str | Path, model: HandModel, shape: Float64[Tensor, "shape"] | None = None) -> MotionClip:
    """The motion of a file. Raises InputError naming the line, what was expected and what was got."""
    path = Path(path)
    rows = list(csv.reader(read_lines_of(path, "a table of joint angles")))
    if not rows or tuple(rows[0]) != _COLUMNS:
        got = short(",".join(rows[0])) if rows else "an empty file"
        raise InputError(f"{path}: expected a table with the columns {', '.join(_COLUMNS[:5])}, …, got {got}")
    if len(rows) < 2:
        raise InputError(f"{path}: expected one frame or more, got none")
    poses, numbers, times, held = [], [], [], []
    for i, row in enumerate(rows[1:], start=2):
        where = f"{path}, line {i}"
        if len(row) != len(_COLUMNS):
            raise InputError(f"{where}: expected {len(_COLUMNS)} cells, got {len(row)}")
        if row[3] not in ("left", "right") or row[3] != rows[1][3]:
            raise InputError(f"{where}: side: expected left or right, the same in all lines, got {short(row[3])}")
        numbers.append(whole(where, row[0]))
        times.append(finite(where, row[1]))
        held += [numbers[-1]] if row[2] == "1" else []
        poses.append([finite(where, cell) for cell in row[4:]])
    values = torch.tensor(poses, dtype=torch.float64)
    quaternion = values[:, 3:7]
    if bool(((quaternion.norm(dim=-1) - 1).abs() > 1e-3).any()):
        raise InputError(f"{path}: qx, qy, qz, qw: expected unit quaternions, got others")
    if any(after <= before for before, after in pairwise(times)):
        raise InputError(f"{path}: time_s: expected increasing times, got others")
    root = vector_from_rotation(rotation_of_quaternion(torch.nn.functional.normalize(quaternion, dim=-1)))
    gaps = torch.tensor(times, dtype=torch.float64).diff()
    return MotionClip(
        model=model,
        side="left" if rows[1][3] == "left" else "right",
        shape=model.shape_space.default.double() if shape is None else shape,
        poses=torch.cat((values[:, :3], root, values[:, 7:]), 1),
        fps=float(1 / gaps.median()) if len(gaps) else 30.0,
        time_s=tuple(times),
        frame=tuple(numbers),
        held=tuple(held),
        name=path.name.removesuffix(JOINTS_SUFFIX) or "hand",
    )
