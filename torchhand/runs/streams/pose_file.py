"""A pose stream (.thp) that grows while a hand is tracked: a packet with a checksum for every frame."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.errors import InputError
from torchhand.export import MAX_GAP_S, PoseStreamWriter, StreamHead, StreamSettings
from torchhand.files import FrameRecord, load_hand_model
from torchhand.files.disk import expanded, explained_errors
from torchhand.hand import DOFS, Side

SUFFIX = ".thp"
_SETTINGS = StreamSettings(packet_poses=1)


class PoseRate(NamedTuple):
    """How times become places in a stream."""

    fps: float
    """Frames per second; above 0."""
    max_gap_s: float = MAX_GAP_S
    """Longest time without frames that is filled with held poses, seconds; above 0."""


class PoseFile:
    """One file. It begins with the first frame that has a hand, whose proportions it keeps; until then it is empty, or
    as it was. Without a hand there is none, or the older one.

    A stream has one rate: each frame takes the place that its time is nearest to. A place that no frame takes, and
    frames without a hand, repeat the pose before and are marked as held; of two frames in one place the first is kept.
    Of a longer time without frames than `PoseRate.max_gap_s` only so much is held: what follows comes early, which is
    said.
    """

    def __init__(self, path: Path, rate: PoseRate, side: Side, say: Callable[[str], None]) -> None:
        """Raises InputError where the file cannot be made."""
        self._is_new = not path.exists()
        with explained_errors(path):
            self._file: BinaryIO = path.open("ab")
        self._path, self._fps, self._max_gap_s, self._say = path, rate.fps, rate.max_gap_s, say
        self._side: Side = side
        self._writer: PoseStreamWriter | None = None
        self._start_s, self._written = 0.0, 0
        self._pose: Float[Tensor, "1 36"] = torch.zeros(1, len(DOFS), dtype=torch.float64)

    def take(self, record: FrameRecord, shape: Float[Tensor, "shape"] | None) -> None:
        """Write what this frame adds; nothing before the first hand. Raises InputError where the disk refuses."""
        has_hand = bool(np.isfinite(record.pose).all())
        time_s = record.frame / self._fps if record.time_s is None else record.time_s
        begins = self._writer is None
        if self._writer is None:
            if not has_hand or shape is None:
                return
            model = load_hand_model()
            head = StreamHead(
                model=model, side=self._side, shape=shape.double().cpu(), fps=self._fps, first=record.frame
            )
            self._writer, self._start_s = PoseStreamWriter(head, _SETTINGS), time_s
        place = round((time_s - self._start_s) * self._fps)
        missed = place - self._written
        if missed < 0:
            return
        missed -= self._left_out(missed, record.frame)
        own = torch.from_numpy(record.pose.astype(np.float64))[None] if has_hand else self._pose
        data = self._writer.add(
            torch.cat((self._pose.expand(missed, -1), own)), np.array([True] * missed + [not has_hand])
        )
        self._pose, self._written = own, self._written + missed + 1
        if begins and self._path.is_file():  # no pipe
            with explained_errors(self._path):
                self._file.truncate(0)
        self._write(self._writer.head + data if begins else data)

    def _left_out(self, missed: int, frame: int) -> int:
        """How many of the places without a frame before this one are too many to be held."""
        too_many = missed - max(0, round(self._max_gap_s * self._fps) - 1)
        if too_many <= 0:
            return 0
        early_s = too_many / self._fps
        self._start_s += early_s
        self._say(
            f"{self._path}: {(missed + 1) / self._fps:.1f} s without pictures before frame {frame} last"
            f" {self._max_gap_s:g} s there (--max-gap-s): what follows comes {early_s:.1f} s early"
        )
        return too_many

    def close(self) -> None:
        """End the stream."""
        try:
            if self._writer is not None:
                self._write(self._writer.end())
        finally:
            self._file.close()
        if self._writer is None and self._is_new:
            with explained_errors(self._path):
                self._path.unlink(missing_ok=True)
        elif self._writer is None:
            self._say(f"{self._path}: is the older stream, for there was no hand")

    def _write(self, data: bytes) -> None:
        with explained_errors(self._path):
            self._file.write(data)
            self._file.flush()


def is_pose_file(text: str) -> bool:
    """Whether a stream goes into a file."""
    return text.lower().endswith(SUFFIX) and "://" not in text


def check_pose_file(text: str, *, may_replace: bool) -> None:
    """Raise InputError where the file cannot be made, or is there already and may not be replaced."""
    path = expanded(Path(text))
    if not path.parent.is_dir():
        raise InputError(f"--stream: {text}: expected a file in an existing folder, got none of {path.parent}")
    if path.exists() and not may_replace:
        raise InputError(f"--stream: {text}: is there already: expected another name, or --overwrite")


@contextlib.contextmanager
def opened_pose_files(
    texts: Sequence[str], rate: PoseRate, side: Side, say: Callable[[str], None]
) -> Iterator[list[PoseFile]]:
    """The files among the streams, which end with the block. say: takes lines for the user. Raises InputError for
    those that cannot be made."""
    with contextlib.ExitStack() as stack:
        files = []
        for text in filter(is_pose_file, texts):
            file = PoseFile(expanded(Path(text)), rate, side, say)
            stack.callback(file.close)
            files.append(file)
        yield files
