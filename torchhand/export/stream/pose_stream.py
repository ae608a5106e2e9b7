"""Gestures at a low bit rate: poses as whole steps, predicted frame by frame, range coded (Ouhaddi and Horain 1998,
section 9).

A .thp file: b"THP" and the version's digit; lengths of header and stream and the CRC-32 of both (three unsigned 32-bit
numbers, little-endian); the header, JSON under zlib; the stream of `step_coder`. The header names everything: fps,
frames, side, shape, the DOFs that move, their steps, and the values of those that do not. No angle of any frame is off
by more than `dead_zone` steps.
"""

import json
import math
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float64
from torch import Tensor

from torchhand.errors import InputError
from torchhand.export.clip import MotionClip
from torchhand.export.stream.container import packed_file, read_header, unpacked
from torchhand.files.disk import replacing
from torchhand.hand import DOFS, FINGERS, ROOT_DOFS, HandModel
from torchhand.numerics.coding import decode_rows, encode_rows, followed

_SHAPE_DIGITS = 9
_NEIGHBOUR = dict(zip(FINGERS[2:], FINGERS[1:-1], strict=True))


@dataclass(frozen=True, kw_only=True)
class StreamSettings:
    """How fine a stream is; the defaults keep recorded human motion within 1 degree on average."""

    step_deg: float = 3.5
    """Step of the joint angles, degrees; above 0, 30 at most."""
    root_step_deg: float = 1.5
    """Step of the rotation vector of the whole hand, degrees; above 0, 30 at most."""
    root_step_mm: float = 2.0
    """Step of its place, millimetres; above 0, 1000 at most."""
    dead_zone: float = 0.55
    """A value that is nearer than so many steps stays as it was; 0.5 to 1."""

    def __post_init__(self) -> None:
        for name, maximum in (("step_deg", 30), ("root_step_deg", 30), ("root_step_mm", 1000)):
            if not 0 < getattr(self, name) <= maximum:
                raise ValueError(f"{name}: expected more than 0, {maximum} at most, got {getattr(self, name):g}")
        if not 0.5 <= self.dead_zone <= 1:
            raise ValueError(f"dead_zone: expected 0.5 to 1, got {self.dead_zone:g}")

    def step_of(self, dof: str) -> float:
        """Step of one of DOFS, metres or radians."""
        if dof.startswith("root_t"):
            return 1e-3 * self.root_step_mm
        return math.radians(self.root_step_deg if dof in ROOT_DOFS else self.step_deg)


@dataclass(frozen=True, kw_only=True)
class StreamFigures:
    """What a stream costs and keeps."""

    header_bytes: int
    """The header and all that is not the motion: sent once."""
    motion_bytes: int
    seconds: float
    mean_deg: float
    """Mean absolute error over the joint angles that move and all frames; 0 where none does."""
    worst_deg: float

    @property
    def kbit_per_s(self) -> float:
        """The motion and the header, over the time that the clip lasts."""
        return 8e-3 * (self.header_bytes + self.motion_bytes) / self.seconds

    @property
    def motion_kbit_per_s(self) -> float:
        """The motion alone."""
        return 8e-3 * self.motion_bytes / self.seconds


def encode_clip(clip: MotionClip, settings: StreamSettings | None = None) -> tuple[bytes, StreamFigures]:
    """The clip as the bytes of a .thp file, and what they cost and keep."""
    settings = settings or StreamSettings()
    poses = clip.poses.clone()
    poses[:, 3:6] = unwrapped(poses[:, 3:6])
    moves = (poses != poses[0]).any(0).tolist()
    names = [dof for dof, does in zip(DOFS, moves, strict=True) if does]
    steps = [settings.step_of(dof) for dof in names]
    columns = [DOFS.index(dof) for dof in names]
    wanted = poses[:, columns].numpy()
    rows = followed(wanted / np.array(steps), settings.dead_zone)
    stream = encode_rows(rows, _partners(names))
    space = clip.model.shape_space
    header = {
        "fps": clip.fps,
        "frames": len(clip),
        "name": clip.name,
        "side": clip.side,
        "up": clip.up,
        "dofs": names,
        "steps": steps,
        "still": {dof: float(poses[0, i]) for i, dof in enumerate(DOFS) if not moves[i] and float(poses[0, i]) != 0},
        "shape": dict(zip(space.names, (float(f"{x:.{_SHAPE_DIGITS}g}") for x in clip.shape.tolist()), strict=True)),
    }
    packed = zlib.compress(json.dumps(header, separators=(",", ":")).encode(), 9)
    data = packed_file(packed, stream)
    error = np.abs(rows * np.array(steps) - wanted)[:, [dof not in ROOT_DOFS for dof in names]]
    return data, StreamFigures(
        header_bytes=len(data) - len(stream),
        motion_bytes=len(stream),
        seconds=len(clip) / clip.fps,
        mean_deg=math.degrees(float(error.mean())) if error.size else 0.0,
        worst_deg=math.degrees(float(error.max())) if error.size else 0.0,
    )


def write_stream(clip: MotionClip, path: str | Path, settings: StreamSettings | None = None) -> StreamFigures:
    """Write the file; returns what it costs and keeps."""
    data, figures = encode_clip(clip, settings)
    with replacing(Path(path)) as temporary:
        temporary.write_bytes(data)
    return figures


def clip_of_stream(path: str | Path, model: HandModel) -> MotionClip:
    """The motion of a .thp file.

    Raises InputError for a file of another kind or version, one that is cut short or damaged, and for a hand that is
    not of this model.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    packed, stream = unpacked(path, data)
    header = read_header(path, packed)
    frames = header["frames"]
    names = header["dofs"]
    poses = torch.zeros(frames, len(DOFS), dtype=torch.float64)
    for dof, value in header["still"].items():
        poses[:, DOFS.index(dof)] = value
    try:
        rows = decode_rows(stream, frames, _partners(names)) * np.array(header["steps"])
    except ValueError as error:
        raise InputError(f"{path}: is damaged ({error})") from error
    for column, dof in enumerate(names):
        poses[:, DOFS.index(dof)] = torch.from_numpy(rows[:, column])
    if set(header["shape"]) != set(model.shape_space.names):
        wrong = sorted(set(header["shape"]) ^ set(model.shape_space.names))
        raise InputError(f"{path}: shape: expected the parameters of {model.name}, got others ({', '.join(wrong[:3])})")
    try:
        return MotionClip(
            model=model,
            side=header["side"],
            shape=torch.tensor([header["shape"][name] for name in model.shape_space.names], dtype=torch.float64),
            poses=poses,
            fps=header["fps"],
            name=header["name"],
            up=header["up"],
        )
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error


def unwrapped(vectors: Float64[Tensor, "frames 3"]) -> Float64[Tensor, "frames 3"]:
    """The same rotations as rotation vectors without jumps by a whole turn: each the nearest to the one before."""
    found = vectors.clone()
    for i in range(1, len(found)):
        before, here = found[i - 1], vectors[i]
        axis = torch.nn.functional.normalize(here if float(here.norm()) > 1e-9 else before, dim=0)
        turns = torch.round((before - here) @ axis / (2 * math.pi))
        found[i] = here + 2 * math.pi * turns * axis
    return found


def _partners(names: list[str]) -> list[int | None]:
    """Which DOF each tends to move with: a DIP with its PIP, a finger's joint with its neighbour's, the thumb's joints
    with its first."""
    found: list[int | None] = []
    for place, dof in enumerate(names):
        finger, _, joint = dof.partition("_")
        if joint == "dip_fe":
            likely = f"{finger}_pip_fe"
        elif finger in _NEIGHBOUR:
            likely = f"{_NEIGHBOUR[finger]}_{joint}"
        else:
            likely = {"index": "index_mcp_fe", "thumb": "thumb_cmc_fe"}.get(finger, "")
        found.append(names.index(likely) if likely in names[:place] else None)
    return found
