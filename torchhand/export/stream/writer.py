"""A pose stream that is written while its motion goes on: poses in, bytes out as soon as a packet is full."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float64
from torch import Tensor

from torchhand.export.clip import Up
from torchhand.export.stream.channels import StreamSettings, partners, unwrapped
from torchhand.export.stream.container import END, HELD, Packet, packed_header, packed_packet
from torchhand.hand import DOFS, HandModel, Side
from torchhand.numerics.coding import RowEncoder, followed

_SHAPE_DIGITS = 9


@dataclass(frozen=True, kw_only=True)
class StreamHead:
    """What holds for all poses of a stream."""

    model: HandModel
    side: Side
    shape: Float64[Tensor, "shape"]
    fps: float
    """Frames per second of every pose; above 0."""
    first: int = 0
    """Number of the first frame."""
    name: str = "hand"
    up: Up = "-y"
    still: Mapping[str, float] = field(default_factory=dict)
    """Degrees of freedom that do not move, and their values: they cost nothing per frame."""
    has_held: bool = True
    """Whether poses may repeat earlier ones because their own were lost."""


class PoseStreamWriter:
    """Encodes a motion frame by frame. The bytes of `head`, of every `add` and of `end`, in this order, are a .thp
    stream; `PoseStreamReader` decodes it while it grows."""

    def __init__(self, head: StreamHead, settings: StreamSettings | None = None) -> None:
        self._settings = settings or StreamSettings()
        self._moving = [dof for dof in DOFS if dof not in head.still]
        self._steps = np.array([self._settings.step_of(dof) for dof in self._moving])
        names = [*self._moving, *([HELD] if head.has_held else [])]
        values = [float(f"{value:.{_SHAPE_DIGITS}g}") for value in head.shape.tolist()]
        self._has_held = head.has_held
        self.head = packed_header(
            {
                "fps": head.fps,
                "first": head.first,
                "name": head.name,
                "side": head.side,
                "up": head.up,
                "dofs": names,
                "steps": [*self._steps.tolist(), *([1.0] if head.has_held else [])],
                "still": {dof: value for dof, value in head.still.items() if value},
                "shape": dict(zip(head.model.shape_space.names, values, strict=True)),
            }
        )
        """The beginning of the stream."""
        self._encoder = RowEncoder(partners(names))
        self._rotation: Float64[Tensor, "1 3"] | None = None
        self._followed: np.ndarray | None = None
        self._waiting = np.zeros((0, len(names)), dtype=np.int64)

    def add(self, poses: Float64[Tensor, "poses 36"], is_held: Bool[np.ndarray, "poses"] | None = None) -> bytes:
        """The packets that these poses fill, none or many: the poses after those of the last call.

        is_held: which of them repeat another because their own was lost. Raises ValueError where one is not finite, and
        where one is held in a stream that has no held ones.
        """
        if is_held is None:
            is_held = np.zeros(len(poses), dtype=bool)
        if is_held.any() and not self._has_held:
            raise ValueError("is_held: expected none in a stream without held poses")
        if not len(poses):
            return b""
        wanted = poses.clone()
        wanted[:, 3:6] = unwrapped(wanted[:, 3:6], self._rotation)
        columns = [DOFS.index(dof) for dof in self._moving]
        rows = followed(wanted[:, columns].numpy() / self._steps, self._settings.dead_zone, start=self._followed)
        self._rotation, self._followed = wanted[-1:, 3:6], rows[-1]
        flags = is_held[:, None] if self._has_held else np.zeros((len(rows), 0), dtype=bool)
        self._waiting = np.concatenate((self._waiting, np.concatenate((rows, flags), 1, dtype=np.int64)))
        size, whole = self._settings.packet_poses, []
        while len(self._waiting) >= size:
            whole.append(self._packet(size))
        return b"".join(whole)

    def end(self) -> bytes:
        """What is left, and the end of the stream."""
        rest = self._packet(len(self._waiting)) if len(self._waiting) else b""
        return rest + END

    def _packet(self, count: int) -> bytes:
        block, self._waiting = self._waiting[:count], self._waiting[count:]
        return packed_packet(Packet(count, self._encoder.block(block)))
