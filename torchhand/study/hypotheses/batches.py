"""The batches of a study in one file that grows: each is whole or not there, whatever ends the program."""

import hashlib
import io
import os
import struct
from pathlib import Path
from typing import BinaryIO

import numpy as np

from torchhand.files.disk import explained_errors
from torchhand.study.hypotheses.record import Hypotheses

_MAGIC = b"torchhand study batches 1\n"
_HEAD = struct.Struct("<QQ32s")
"""Before every batch: its number, its size in bytes, the SHA-256 of number and bytes."""


class BatchFile:
    """Batches by number. What a killed program or a full disk left of one at the end is overwritten by the next."""

    def __init__(self, path: Path) -> None:
        """Find the batches that the file holds, if there is one. Raises InputError where the disk refuses."""
        self.path = path
        self._places: dict[int, tuple[int, int]] = {}
        """Of every batch its first byte and its size."""
        self._end = 0
        if path.exists():
            with explained_errors(path), path.open("rb") as file:
                self._find_batches(file)

    def save(self, number: int, hypotheses: Hypotheses) -> None:
        """Keep one batch for good. Raises InputError where the disk refuses."""
        packed = io.BytesIO()
        np.savez(packed, **hypotheses.arrays())  # pyright: ignore[reportArgumentType] - the stub lacks keywords
        content = packed.getvalue()
        head = _HEAD.pack(number, len(content), _digest(number, content))
        with explained_errors(self.path), self.path.open("r+b" if self._end else "wb") as file:
            first = file.seek(self._end) + file.write(head if self._end else _MAGIC + head)
            end = first + file.write(content)
            file.truncate()
        self._places[number], self._end = (first, len(content)), end

    def __contains__(self, number: int) -> bool:
        return number in self._places

    def load(self, number: int) -> Hypotheses:
        """A batch that the file contains. Raises KeyError for another one."""
        first, size = self._places[number]
        with explained_errors(self.path), self.path.open("rb") as file:
            file.seek(first)
            content = file.read(size)
        with np.load(io.BytesIO(content), allow_pickle=False) as stored:
            return Hypotheses.from_arrays(stored)

    def _find_batches(self, file: BinaryIO) -> None:
        """All up to the first that is not whole."""
        if file.read(len(_MAGIC)) != _MAGIC:
            return
        left = os.fstat(file.fileno()).st_size - len(_MAGIC)
        while left >= _HEAD.size:
            number, size, digest = _HEAD.unpack(file.read(_HEAD.size))
            left -= _HEAD.size + size
            if left < 0 or _digest(number, content := file.read(size)) != digest:
                return
            self._end = file.tell()
            self._places[number] = (self._end - len(content), len(content))


def _digest(number: int, content: bytes) -> bytes:
    return hashlib.sha256(number.to_bytes(8, "little") + content).digest()
