"""A command's `main`: the user's mistakes become one line and exit code 2."""

import contextlib
import errno
import functools
import os
import sys
import traceback
from collections.abc import Callable
from typing import ParamSpec

from torchhand.cli.command.verbosity import is_verbose, telling
from torchhand.errors import DiskError, InputError

Parameters = ParamSpec("Parameters")

DONE = 0
DISK_REFUSES = 1
WRONG_INPUT = 2
STOPPED_BY_USER = 130  # 128 + SIGINT, as a shell reports it
READER_WENT_AWAY = 141  # 128 + SIGPIPE


def command(main: Callable[Parameters, int]) -> Callable[Parameters, int]:
    """Decorator of a command's `main(argv)`; the command is called after the file that holds it.

    InputError, and OSError (no such file, no permission), become one line on stderr and exit code 2, a disk that is
    full or failing one line and 1. Ctrl-C becomes one line and 130. A reader that closes the pipe early (`| head`) ends
    the command quietly. Anything else is a mistake of ours and keeps its traceback.
    """
    name = f"torchhand {main.__module__.rpartition('.')[2]}"

    @functools.wraps(main)
    def guarded(*args: Parameters.args, **kwargs: Parameters.kwargs) -> int:
        try:
            with telling():
                try:
                    code = main(*args, **kwargs)
                except (InputError, OSError):
                    if is_verbose():
                        traceback.print_exc()
                    raise
            sys.stdout.flush()
            return code
        except InputError as error:
            print(f"{name}: error: {_one_line(str(error))}", file=sys.stderr)
            return DISK_REFUSES if isinstance(error, DiskError) else WRONG_INPUT
        except BrokenPipeError:
            return reader_went_away()
        except OSError as error:
            print(f"{name}: error: {_one_line(_os_error_text(error))}", file=sys.stderr)
            return DISK_REFUSES if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EIO) else WRONG_INPUT
        except KeyboardInterrupt:
            print(f"{name}: stopped by Ctrl-C", file=sys.stderr)
            return STOPPED_BY_USER
        except SystemExit as stop:  # tyro after --help
            return stop.code if isinstance(stop.code, int) else DONE

    return guarded


def reader_went_away() -> int:
    """The exit code when nobody reads standard output any more, which from here on takes everything.

    The interpreter flushes it once more at exit.
    """
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return READER_WENT_AWAY


def _os_error_text(error: OSError) -> str:
    if error.filename is None or error.strerror is None:
        return str(error)
    return f"{error.filename}: {error.strerror}"


def _one_line(text: str) -> str:
    return " ".join(text.split())
