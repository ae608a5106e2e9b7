"""Rooms, functions and signatures of a size that one reads at once."""

import ast
from collections.abc import Iterator
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1] / "torchhand"

MAX_FILES = 13  # of a room, its door not counted
LARGER_ROOMS = {
    "cli": 25,  # commands only, 23 of them, one file each, and the two that find them
    "fit/hull": 15,  # one fit: each observation of a hull, its settings and its start are a file each
}

MAX_LINES = 60  # of a function, its docstring not counted
MAX_PARAMETERS = 8  # of a function, self and cls not counted
LONGER = {
    "view/raster/compiled.py:_fill": 64,  # a kernel that numba compiles: what it called would be compiled with it
}

Function = ast.FunctionDef | ast.AsyncFunctionDef


def functions() -> Iterator[tuple[str, Function]]:
    """All functions and methods of the package, with where they stand."""
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, Function):
                yield f"{path.relative_to(PACKAGE).as_posix()}:{node.name}", node


def lines(function: Function) -> int:
    """From `def` to the end, without the docstring."""
    assert function.end_lineno is not None
    count = function.end_lineno - function.lineno + 1
    if ast.get_docstring(function) is None:
        return count
    docstring = function.body[0]
    assert docstring.end_lineno is not None
    return count - (docstring.end_lineno - docstring.lineno + 1)


def parameters(function: Function) -> int:
    given = function.args
    names = [one.arg for one in (*given.posonlyargs, *given.args, *given.kwonlyargs)]
    extra = sum(one is not None for one in (given.vararg, given.kwarg))
    return extra + len([name for name in names if name not in ("self", "cls")])


def test_a_room_holds_at_most_a_dozen_files_or_so() -> None:
    rooms = {path.parent for path in PACKAGE.rglob("*.py")}
    counts = {room: len([path for path in room.glob("*.py") if path.name != "__init__.py"]) for room in rooms}
    allowed = {PACKAGE / name: count for name, count in LARGER_ROOMS.items()}
    too_large = {
        room.relative_to(PACKAGE).as_posix(): count
        for room, count in counts.items()
        if count > allowed.get(room, MAX_FILES)
    }
    assert too_large == {}
    assert {room: counts[room] for room in allowed} == allowed, "an exception that is no longer needed"


def test_functions_are_short() -> None:
    assert {place: lines(node) for place, node in functions() if lines(node) > MAX_LINES} == LONGER


def test_signatures_are_short() -> None:
    assert {place: parameters(node) for place, node in functions() if parameters(node) > MAX_PARAMETERS} == {}
