"""Programs that are killed while they move their results into place."""

import os
from pathlib import Path

import pytest


class Stop(Exception):
    """The end of the program."""


def stop_after(moves: int, folder: Path, patched: pytest.MonkeyPatch) -> None:
    """Let the program end before the next move of a file into the folder once that many were made."""
    replace_file, left = os.replace, [moves]

    def replace(source: Path, target: Path) -> None:
        if Path(target).parent == folder and Path(source).parent != folder:
            if not left[0]:
                raise Stop
            left[0] -= 1
        replace_file(source, target)

    patched.setattr(os, "replace", replace)
