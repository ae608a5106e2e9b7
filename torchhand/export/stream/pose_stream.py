"""Gestures at a low bit rate: poses as whole steps, predicted frame by frame, range coded (Ouhaddi and Horain 1998,
section 9).

A .thp stream is a header and packets of poses (`container`), which can be decoded while it grows. The header names
everything: fps, number of the first frame, side, shape, the DOFs that move, their steps, and the values of those that
do not. No angle of any frame is off by more than `dead_zone` steps.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float64
from torch import Tensor

from torchhand.errors import InputError
from torchhand.export.clip import MotionClip
from torchhand.export.stream.channels import StreamSettings, partners, unwrapped
from torchhand.export.stream.container import END, HELD, StreamBuffer
from torchhand.export.stream.writer import PoseStreamWriter, StreamHead
from torchhand.files.disk import replacing
from torchhand.hand import DOFS, JOINT_DOFS, HandModel
from torchhand.numerics.coding import RowDecoder, followed


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
    """The clip as the bytes of a .thp file, and what they cost and keep. Uneven times are made even first."""
    settings = settings or StreamSettings()
    clip = clip.placed("camera").at_constant_rate()
    poses = clip.poses.clone()
    poses[:, 3:6] = unwrapped(poses[:, 3:6])
    still = {dof: float(poses[0, i]) for i, dof in enumerate(DOFS) if bool((poses[:, i] == poses[0, i]).all())}
    head = StreamHead(
        model=clip.model,
        side=clip.side,
        shape=clip.shape.double(),
        fps=clip.fps,
        first=clip.frame[0],
        name=clip.name,
        up=clip.up,
        still=still,
        has_held=bool(clip.held),
    )
    writer = PoseStreamWriter(head, settings)
    motion = writer.add(poses, ~np.array(clip.is_own) if clip.held else None) + writer.end()
    moving = [dof for dof in JOINT_DOFS if dof not in still]
    wanted = poses[:, [DOFS.index(dof) for dof in moving]].numpy()
    steps = np.array([settings.step_of(dof) for dof in moving])
    error = np.abs(followed(wanted / steps, settings.dead_zone) * steps - wanted)
    return writer.head + motion, StreamFigures(
        header_bytes=len(writer.head),
        motion_bytes=len(motion),
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


class PoseStreamReader:
    """Decodes a pose stream while it grows: bytes in, as they come, poses out as soon as their packet is whole."""

    def __init__(self, model: HandModel, where: str | Path = "stream") -> None:
        """model: whose hand the stream shows. where: what errors call the stream."""
        self.model = model
        self.header: dict[str, Any] | None = None
        """What holds for all poses, once it has come: fps, name, side, up, shape …"""
        self._buffer = StreamBuffer(Path(where))

    @property
    def has_ended(self) -> bool:
        """Whether the end of the stream has come."""
        return self._buffer.has_ended

    def feed(self, data: bytes) -> tuple[Float64[Tensor, "poses 36"], Bool[np.ndarray, "poses"]]:
        """The poses that these bytes complete, and which of them are held; none or many.

        Raises InputError for another kind or version of stream, for damage, and for a hand that is not of this model.
        """
        self._buffer.add(data)
        if self.header is None and not self._begin():
            return torch.zeros(0, len(DOFS), dtype=torch.float64), np.zeros(0, dtype=bool)
        assert self.header is not None
        found = [np.zeros((0, len(self.header["dofs"])), dtype=np.int64)]
        while (packet := self._buffer.packet()) is not None:
            try:
                found.append(self._decoder.block(packet.content, packet.count))
            except ValueError as error:
                raise InputError(f"{self._buffer.where}: is damaged ({error})") from error
        rows = np.concatenate(found) * np.array(self.header["steps"])
        poses = torch.zeros(len(rows), len(DOFS), dtype=torch.float64)
        for dof, value in self.header["still"].items():
            poses[:, DOFS.index(dof)] = value
        held = np.zeros(len(rows), dtype=bool)
        for column, name in enumerate(self.header["dofs"]):
            if name == HELD:
                held = rows[:, column] > 0.5
            else:
                poses[:, DOFS.index(name)] = torch.from_numpy(rows[:, column])
        return poses, held

    def _begin(self) -> bool:
        """Read the header if it is whole."""
        header = self._buffer.header()
        if header is None:
            return False
        if set(header["shape"]) != set(self.model.shape_space.names):
            wrong = sorted(set(header["shape"]) ^ set(self.model.shape_space.names))
            raise InputError(
                f"{self._buffer.where}: shape: expected the parameters of {self.model.name}, got others"
                f" ({', '.join(wrong[:3])})"
            )
        self.header, self._decoder = header, RowDecoder(partners(header["dofs"]))
        return True


def clip_of_stream(path: str | Path, model: HandModel) -> MotionClip:
    """The motion of a .thp file; of one that still grows, or was cut short, that of its whole packets, with a note.

    Raises InputError for a file of another kind or version, one that is damaged or has not one whole packet, and for a
    hand that is not of this model.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    reader = PoseStreamReader(model, path)
    poses, held = reader.feed(data)
    header = reader.header
    if header is not None and not reader.has_ended and data.endswith(END):  # a damaged length has swallowed the rest
        raise InputError(f"{path}: is damaged: after {len(poses)} poses a packet is longer than the rest of the stream")
    if header is None or not len(poses):
        raise InputError(f"{path}: is cut short: expected a header and a packet of poses, got {len(data)} bytes")
    note = f"the stream has no end yet: the {len(poses)} poses that are whole were read"
    try:
        return MotionClip(
            model=model,
            side=header["side"],
            shape=torch.tensor([header["shape"][name] for name in model.shape_space.names], dtype=torch.float64),
            poses=poses,
            fps=header["fps"],
            frame=tuple(range(header["first"], header["first"] + len(poses))),
            held=tuple(header["first"] + int(place) for place in np.flatnonzero(held)),
            name=header["name"],
            up=header["up"],
            notes=() if reader.has_ended else (note,),
        )
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error
