"""A command's arguments, read into a record, beside those that every command has."""

import contextlib
import inspect
import io
import itertools
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, make_dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

import tyro
from tyro.conf import FlagCreatePairsOff, arg

from torchhand.cli.command.guard import DONE, WRONG_INPUT
from torchhand.cli.command.inputs import check_inputs_stay
from torchhand.cli.command.verbosity import tell
from torchhand.errors import InputError

Arguments = TypeVar("Arguments")

MAX_THREADS = 1024

HELP_TEXT_INDENT = " " * 9  # in tyro's messages; names stand 4 columns further left
UNWANTED = ("For full helptext", "Argument helptext")
_WRONG_CHOICE = re.compile(r"invalid choice (.*) for argument '([^']*)'\. Expected one of \((.*)\)")
_MISSING_VALUE = re.compile(r"Missing value for argument '([^']*)'\. Expected (\d+) values")
_WRONG_SEVERAL = re.compile(
    r"Error parsing ([^:]*): .*Could not parse arguments (\[.*?\]) into tuple type (?:typing\.T|t)uple\[(.*)\].*"
)
_EMPTY_OPTION = re.compile(r"--[\w-]+=")
_OF_A_RECORD = re.compile(r"^Error parsing [\w.]+: (?=--)")
"""Before what a record's own check says."""
_WRONG_NUMBERS = {
    "a whole number": re.compile(r"Error parsing ([^:]*): .*invalid literal for int\(\) with base 10: ('.*')"),
    "a number": re.compile(r"Error parsing ([^:]*): .*could not convert string to float: ('.*')"),
}


@dataclass(frozen=True, kw_only=True)
class _OfEveryCommand:
    quiet: Annotated[FlagCreatePairsOff[bool], arg(aliases=["-q"])] = False
    """Nothing on stderr but errors: no progress, no notes. What a command prints as its result stays."""
    verbose: Annotated[FlagCreatePairsOff[bool], arg(aliases=["-v"])] = False
    """Tell more on stderr: every frame with its time, what a run is made of, its duration and memory, the traceback of
    an error."""

    def __post_init__(self) -> None:
        if self.quiet and self.verbose:
            raise ValueError("--quiet: expected no --verbose with it")


@dataclass(frozen=True, kw_only=True)
class OnDevice:
    """Base of the arguments of a command that computes on a device; `torchhand.devices.device_named` finds it."""

    device: str = "cpu"
    """Device to compute on: cpu, or cuda."""


@dataclass(frozen=True, kw_only=True)
class _OfSettings(_OfEveryCommand):
    print_config: FlagCreatePairsOff[bool] = False
    """Print the settings that the other options make, as YAML that --config reads, and do nothing else."""


def parse(
    kind: type[Arguments],
    argv: Sequence[str] | None,
    *,
    name: str,
    settings: Callable[[Arguments], Any] | None = None,
) -> Arguments:
    """Read the command line into a record (a dataclass, whose docstring is the text of `--help`).

    Every command has --quiet and --verbose too, which hold until it ends. settings: makes a command's settings from its
    arguments; the command then has --print-config, which ends it with SystemExit, the settings printed.

    Raises:
        InputError: a word is empty or no UTF-8, the command line does not fit the record, the record's own range
            check (ValueError) refuses it, or what is to be replaced is to be read.
    """
    # What loads torch is left to what needs it: help does not.
    from torchhand.files.disk import check_name

    for before, word in itertools.pairwise(("", *(sys.argv[1:] if argv is None else argv))):
        if not word or _EMPTY_OPTION.fullmatch(word):  # as a path it would mean the current folder
            place = word or before
            raise InputError(f"expected a value{f' after {place}' if place else ''}, got an empty argument")
        check_name(word)
        if re.match("-[^-].", word) and Path(word).exists():  # -q and -v are options
            raise InputError(f"{word}: expected ./{word} for a file whose name begins with a dash")
    given, common = _read(kind, argv, name, has_settings=settings is not None)
    check_inputs_stay(given)
    if settings is not None and common.print_config:
        from torchhand.files import settings_text

        print(settings_text(settings(given)), end="")
        raise SystemExit(DONE)
    tell(name, is_quiet=common.quiet, is_verbose=common.verbose)
    return given


def print_help(kind: type, *, name: str, has_settings: bool) -> None:
    """What `--help` prints of a command with such a record."""
    with contextlib.suppress(SystemExit):
        _read(kind, ["--help"], name, has_settings=has_settings)


def whole_record(kind: type, *, has_settings: bool) -> type:
    """The record of a command together with what every command has."""
    common = _OfSettings if has_settings else _OfEveryCommand
    fields = [(part, Annotated[part_kind, arg(name="")]) for part, part_kind in (("given", kind), ("common", common))]
    # The docstring whole: tyro on its own takes an "Example:" for a section of arguments and drops it.
    return make_dataclass(kind.__name__, fields, namespace={"__doc__": inspect.getdoc(kind)})


def _read(kind: type, argv: Sequence[str] | None, name: str, *, has_settings: bool) -> tuple[Any, Any]:
    complaint = io.StringIO()
    whole = whole_record(kind, has_settings=has_settings)
    try:
        with contextlib.redirect_stderr(complaint):
            read: Any = tyro.cli(whole, args=argv, prog=f"torchhand {name}", description=inspect.getdoc(kind))
    except ValueError as error:
        raise InputError(str(error)) from error
    except SystemExit as stop:
        if stop.code != WRONG_INPUT:
            raise
        raise InputError(f"{_text_of_box(complaint.getvalue())} (see torchhand {name} --help)") from stop
    return read.given, read.common


def one_address(ray: Sequence[str] | None) -> str | None:
    """What a command calls --ray [ADDRESS]: the address, if one is given.

    Raises:
        ValueError: several addresses.
    """
    if ray is not None and len(ray) > 1:
        raise ValueError(f"--ray: expected one address or none, got {' '.join(ray)}")
    return ray[0] if ray else None


@contextlib.contextmanager
def threads(count: int) -> Iterator[None]:
    """torch computes with so many threads inside the block, for what a command calls --threads.

    Raises:
        InputError: not a number of threads.
    """
    import torch

    if not 1 <= count <= MAX_THREADS:
        raise InputError(f"--threads: expected 1 to {MAX_THREADS}, got {count}")
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def workers_of(workers: int | None, threads: int) -> int:
    """How many processes share independent inputs, for what a command calls --workers: where none is given, as many as
    there are cores; one where a fit has several threads, which a copy has not.

    Raises:
        InputError: not a number of workers.
    """
    from torchhand.cluster import usable_cores

    if workers is not None and not 1 <= workers <= MAX_THREADS:
        raise InputError(f"--workers: expected 1 to {MAX_THREADS}, got {workers}")
    return 1 if threads > 1 else usable_cores() if workers is None else workers


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
    return "; ".join(_plainly(sentence) for sentence in sentences if sentence and not sentence.startswith(UNWANTED))


def _as_in_help(name: str) -> str:
    """An option as it is; an argument without one by the name of its field, in capitals."""
    return name if name.startswith("-") else name.rpartition(".")[2].upper()


def _plainly(sentence: str) -> str:
    """One of tyro's sentences in the form of our own: the option, what was expected, what was given."""
    if found := _WRONG_CHOICE.fullmatch(sentence):
        got, name, listed = found.groups()
        allowed = sorted(set(re.findall("'([^']*)'", listed)) - {"None"})
        choices = " or ".join(allowed) if len(allowed) < 3 else f"one of {', '.join(allowed)}"
        return f"{name}: expected {choices}, got {got}"
    if found := _MISSING_VALUE.fullmatch(sentence):
        name, count = _as_in_help(found[1]), found[2]
        return f"{name}: expected {'a value, got none' if count == '1' else f'{count} values, got fewer'}"
    if found := _WRONG_SEVERAL.fullmatch(sentence):
        name, listed, kinds = found.groups()
        numbers = "whole numbers" if kinds.startswith("int") else "numbers"
        given = " ".join(re.findall("'([^']*)'", listed))
        return f"{name}: expected {kinds.count(',') + 1} {numbers}, got '{given}'"
    for kind, wrong in _WRONG_NUMBERS.items():
        if found := wrong.fullmatch(sentence):
            return f"{found[1]}: expected {kind}, got {found[2]}"
    return _OF_A_RECORD.sub("", sentence)
