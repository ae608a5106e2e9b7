"""A command's arguments, read into a record."""

import contextlib
import inspect
import io
import sys
from collections.abc import Iterator, Sequence
from typing import TypeVar

import torch
import tyro

from torchhand.cli.command.guard import WRONG_INPUT
from torchhand.errors import InputError
from torchhand.files.disk import check_name

Arguments = TypeVar("Arguments")

MAX_THREADS = 1024

HELP_TEXT_INDENT = " " * 9  # in tyro's messages; names stand 4 columns further left
UNWANTED = ("For full helptext", "Argument helptext")


def parse(kind: type[Arguments], argv: Sequence[str] | None, *, name: str) -> Arguments:
    """Read the command line into a record (a dataclass, whose docstring is the text of `--help`).

    Raises:
        InputError: a word is empty or no UTF-8, the command line does not fit the record, or the record's own range
            check (ValueError) refuses it.
    """
    for word in sys.argv[1:] if argv is None else argv:
        if not word:
            raise InputError("expected a value, got an empty argument")  # as a path it would mean the current folder
        check_name(word)
    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            # The docstring whole: tyro on its own takes an "Example:" for a section of arguments and drops it.
            return tyro.cli(kind, args=argv, prog=f"torchhand {name}", description=inspect.getdoc(kind))
    except ValueError as error:
        raise InputError(str(error)) from error
    except SystemExit as stop:
        if stop.code != WRONG_INPUT:
            raise
        raise InputError(f"{_text_of_box(complaint.getvalue())} (see torchhand {name} --help)") from stop


@contextlib.contextmanager
def threads(count: int) -> Iterator[None]:
    """torch computes with so many threads inside the block, for what a command calls --threads.

    Raises:
        InputError: not a number of threads.
    """
    if not 1 <= count <= MAX_THREADS:
        raise InputError(f"--threads: expected 1 to {MAX_THREADS}, got {count}")
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _text_of_box(text: str) -> str:
    """The sentences of tyro's framed message on one line: without its frame, title, help texts and closing hint."""
    paragraphs: list[list[str]] = [[]]
    for line in text.splitlines()[1:-1]:
        framed = line.strip("│|")
        inside = framed.strip()
        if inside and not inside.strip("─-"):
            paragraphs.append([])
        elif not framed.startswith(HELP_TEXT_INDENT):
            paragraphs[-1].append(inside)
    sentences = [" ".join(paragraph).strip(" .") for paragraph in paragraphs]
    return "; ".join(sentence for sentence in sentences if sentence and not sentence.startswith(UNWANTED))
