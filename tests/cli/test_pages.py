"""The pages tell every command, and no option that there is not."""

import dataclasses
import re
import typing
from functools import cache
from pathlib import Path

from torchhand.cli.command import arguments_of
from torchhand.cli.main import command_descriptions
from torchhand.cli.studies import DESIGN, EXPORT, UEDA
from torchhand.files import Track

REPOSITORY = Path(__file__).resolve().parents[2]
PAGES = {
    path.relative_to(REPOSITORY).as_posix(): path.read_text(encoding="utf-8")
    for path in (REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").glob("*.md")))
}


def test_every_command_is_told() -> None:
    rows = re.findall(r"^\| `(\w+)", PAGES["docs/commands.md"], flags=re.MULTILINE)
    assert set(command_descriptions()) <= set(rows)


def test_every_field_of_a_track_is_told() -> None:
    table = PAGES["docs/formats.md"].partition("## track.npz")[2].partition("`poses.npz` of")[0]
    told = {
        name for row in re.findall(r"^\| (`.*?) \|", table, flags=re.MULTILINE) for name in re.findall("`(\\w+)`", row)
    }
    assert {field.name for field in dataclasses.fields(Track)} - {"measures", "image"} <= told


def test_options_that_pages_name_exist() -> None:
    """Of every command line in a block of code or in backticks."""
    lines = [
        line
        for text in PAGES.values()
        for block in re.findall(r"```\n(.*?)```|`(torchhand [^`]+)`", text, flags=re.DOTALL)
        for line in "".join(block).splitlines()
    ]
    commands, checked = command_descriptions(), 0
    for line in lines:
        found = re.match(r"(?:bash )?torchhand (\w+)(.*)", line.partition("#")[0])
        if found is None or found[1] not in commands:
            continue
        word = next(iter(found[2].split()), "")
        is_of_study = found[1] == "study" and word in (UEDA, DESIGN, EXPORT)
        known = {"--help", "--quiet", "--verbose", "--print-config"}
        known |= options_of(f"studies.{word}" if is_of_study else found[1])
        wrong = set(re.findall(r"(?<=\s)--[a-z][\w-]*", found[2])) - known
        assert wrong == set(), line
        checked += 1
    assert checked > 20


@cache
def options_of(command: str) -> set[str]:
    return option_names(arguments_of(f"torchhand.cli.{command}"))


def option_names(record: type | None) -> set[str]:
    """Of a command's record, and of the records in it."""
    assert record is not None
    names = set()
    for name, kind in typing.get_type_hints(record, include_extras=True).items():
        inner = typing.get_args(kind)[0] if typing.get_args(kind) else kind
        if dataclasses.is_dataclass(inner):
            names |= option_names(inner if isinstance(inner, type) else None)
        extras = getattr(kind, "__metadata__", ())
        called = [extra.name for extra in extras if getattr(extra, "name", None)] or [name]
        called += [alias.removeprefix("--") for extra in extras for alias in getattr(extra, "aliases", None) or ()]
        for word in (one.replace("_", "-") for one in called):
            names |= {f"--{word}", f"--no-{word}"}
    return names
