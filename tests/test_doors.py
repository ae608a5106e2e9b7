"""Every package has one door, its `__init__`: code outside a package imports what the door exports, never its files."""

import ast
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import torchhand

REPOSITORY = Path(__file__).resolve().parents[1]
FILES = sorted(path for folder in ("torchhand", "tests", "scripts") for path in (REPOSITORY / folder).rglob("*.py"))
WITHOUT_A_ROOM = {"torchhand.devices", "torchhand.errors", "torchhand.precision"}


def home(path: Path) -> str:
    """The package of a file; tests mirror those that they test, and scripts are the commands."""
    top, *rooms = path.relative_to(REPOSITORY).parent.parts
    return "torchhand.cli" if top == "scripts" else ".".join(("torchhand", *rooms))


def is_file(name: str) -> bool:
    return (REPOSITORY / name.replace(".", "/")).with_suffix(".py").is_file()


def is_room(name: str) -> bool:
    return (REPOSITORY / name.replace(".", "/") / "__init__.py").is_file()


@cache
def exports(room: str) -> set[str]:
    """What the door of a package lists."""
    tree = ast.parse((REPOSITORY / room.replace(".", "/") / "__init__.py").read_text(encoding="utf-8"))
    lists = [node.value for node in tree.body if isinstance(node, ast.Assign) and isinstance(node.value, ast.List)]
    return {ast.literal_eval(item) for found in lists for item in found.elts}


def imports(path: Path) -> Iterator[tuple[str, str]]:
    """Module and name of everything that a file imports from torchhand, at its top or later."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "torchhand":
            yield from ((node.module or "", alias.name) for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names if alias.name.startswith("torchhand."))


def test_what_is_outside_comes_in_through_the_door() -> None:
    faults = []
    for path in FILES:
        own, is_test = home(path), path.is_relative_to(REPOSITORY / "tests")
        for module, name in imports(path):
            is_exported = is_room(module) and name in exports(module)
            file = next((file for file in (module, f"{module}.{name}") if is_file(file)), None)
            if file is not None and not is_exported and file not in WITHOUT_A_ROOM:
                room = file.rpartition(".")[0]
                is_inside = is_test and own != "torchhand" and room.startswith(f"{own}.")
                if room != own and not is_inside:
                    faults.append(f"{path.relative_to(REPOSITORY)}: {file}: expected the door {room}")
    assert not faults, "\n".join(faults)


def test_no_room_needs_a_room_that_needs_it() -> None:
    needs: dict[str, set[str]] = {}
    for path in FILES:
        if path.is_relative_to(REPOSITORY / "torchhand"):
            rooms = {module if is_room(module) else module.rpartition(".")[0] for module, _ in imports(path)}
            needs.setdefault(home(path), set()).update(rooms - {home(path), "torchhand"})
    TopologicalSorter(needs).prepare()  # raises CycleError


def test_a_door_exports_what_it_imports() -> None:
    for path in FILES:
        if path.name == "__init__.py" and path.parent != REPOSITORY / "torchhand":
            listed = exports(home(path))
            assert listed == {name for _, name in imports(path)}, path
            assert not [name for name in listed if name.startswith("_")], path


def test_the_top_level_lists_what_it_has_not_loaded_yet() -> None:
    assert set(torchhand.__all__) <= set(dir(torchhand))
