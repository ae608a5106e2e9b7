"""What every command shares: reading its arguments, and turning the user's mistakes into one line and exit code 2."""

import contextlib
import functools
import inspect
import io
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import ParamSpec, TypeVar

import torch
import tyro

from torchhand.errors import InputError

Arguments = TypeVar("Arguments")
Parameters = ParamSpec("Parameters")

DONE = 0
WRONG_INPUT = 2
STOPPED_BY_USER = 130  # 128 + SIGINT, as a shell reports it
READER_WENT_AWAY = 141  # 128 + SIGPIPE

MAX_THREADS = 1024

HELP_TEXT_INDENT = " " * 9  # in tyro's messages; names stand 4 columns further left
UNWANTED = ("For full helptext", "Argument helptext")


def command(main: Callable[Parameters, int]) -> Callable[Parameters, int]:
    """Decorator of a command's `main(argv)`; the command is called after the file that holds it.

    InputError, and OSError (no such file, no permission, disk full), become one line on stderr and exit code 2. Ctrl-C
    becomes one line and 130. A reader that closes the pipe early (`| head`) ends the command quietly. Anything else is
    a mistake of ours and keeps its traceback.
    """
    name = f"torchhand {main.__module__.rpartition('.')[2]}"

    @functools.wraps(main)
    def guarded(*args: Parameters.args, **kwargs: Parameters.kwargs) -> int:
        try:
            code = main(*args, **kwargs)
            sys.stdout.flush()
            return code
        except InputError as error:
            print(f"{name}: error: {_one_line(str(error))}", file=sys.stderr)
            return WRONG_INPUT
        except BrokenPipeError:
            # The interpreter flushes stdout once more at exit; give it a place that takes everything.
            with contextlib.suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return READER_WENT_AWAY
        except OSError as error:
            print(f"{name}: error: {_one_line(_os_error_text(error))}", file=sys.stderr)
            return WRONG_INPUT
        except KeyboardInterrupt:
            print(f"{name}: stopped by Ctrl-C", file=sys.stderr)
            return STOPPED_BY_USER
        except SystemExit as stop:  # tyro after --help
            return stop.code if isinstance(stop.code, int) else DONE

    return guarded


def parse(kind: type[Arguments], argv: Sequence[str] | None, *, name: str) -> Arguments:
    """Read the command line into a record (a dataclass, whose docstring is the text of `--help`).

    Raises:
        InputError: the command line does not fit the record, or the record's own range check (ValueError) refuses it.
    """
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


def _os_error_text(error: OSError) -> str:
    if error.filename is None or error.strerror is None:
        return str(error)
    return f"{error.filename}: {error.strerror}"


def _one_line(text: str) -> str:
    return " ".join(text.split())
