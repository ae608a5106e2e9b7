"""Files that grow by whole lines of JSON, so that what a program had written outlives it however it ends."""

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from torchhand.files.disk.safe_write import explained_errors


class LineFile:
    """A text file that grows by whole lines: a line that cannot be written to its end leaves no trace.

    Every line goes to the operating system at once, so that it outlives the program however that ends.
    """

    def __init__(self, path: Path, *, size: int) -> None:
        """Open for writing after the first `size` bytes; what comes later is cut off."""
        self.path = path
        with explained_errors(path):
            self._file = open(path, "r+b" if size else "wb", buffering=0)  # noqa: SIM115 - closed by close()
            self._file.truncate(size)
            self._file.seek(size)
        self._size = size

    def append(self, line: str) -> None:
        """Write one line. Raises InputError where the disk refuses, after removing the piece that was written."""
        rest = memoryview(line.encode() + b"\n")
        size = self._size + len(rest)
        with explained_errors(self.path):
            try:
                while rest:
                    rest = rest[self._file.write(rest) :]
            except OSError:
                self._file.truncate(self._size)
                raise
        self._size = size

    def sync(self) -> None:
        """Wait until all is on the disk itself."""
        with explained_errors(self.path):
            os.fsync(self._file.fileno())

    def close(self) -> None:
        with explained_errors(self.path):
            self._file.close()


def read_lines(path: Path) -> Iterator[tuple[dict[str, Any], int]]:
    """The records of a JSON-lines file, each with the offset in bytes of its end.

    Ends at the first line that is incomplete or no JSON object: what a killed program or a full disk leaves behind.
    """
    end = 0
    with path.open("rb") as file:
        for line in file:
            end += len(line)
            try:
                record = json.loads(line)
            except (ValueError, RecursionError):
                return
            if not line.endswith(b"\n") or not isinstance(record, dict):
                return
            yield record, end
