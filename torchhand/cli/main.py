"""`torchhand NAME ...`: find the command NAME and run it.

A command is a file of this package with a function `main(argv: list[str] | None = None) -> int`; the first line of the
file's docstring is its line in `torchhand --help`. The files are only read for that, never imported, so that the list
appears without loading torch.
"""

import ast
import difflib
import gc
import importlib
import pkgutil
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from types import ModuleType
from typing import Annotated, Any, Union

import torchhand
from torchhand import cli

USAGE = """usage: torchhand COMMAND [ARGUMENTS]

{description}

commands:
{commands}

`torchhand COMMAND --help` explains one command, with an example. `torchhand --completion SHELL` prints what completes
commands and options in bash, zsh or fish."""

COMPLETION = "--completion"
SHELLS = ("bash", "zsh", "fish")


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 0 done, 2 the user's input is wrong, 130 stopped by Ctrl-C."""
    try:
        code = _run(list(sys.argv[1:] if argv is None else argv))
        sys.stdout.flush()
        return code
    except BrokenPipeError:  # `torchhand track --help | head -3`
        from torchhand.cli.command import reader_went_away

        return reader_went_away()


def _run(arguments: list[str]) -> int:
    if not arguments or arguments[0] in ("-h", "--help", "help"):
        print(_usage(), file=sys.stdout if arguments else sys.stderr)
        return 0 if arguments else 2
    if arguments[0] == "--version":
        print(f"torchhand {torchhand.__version__}")
        return 0
    if arguments[0] == COMPLETION:
        return _print_completion(arguments[1:])
    name = arguments[0].replace("-", "_")
    if name not in _files() or _description(name) is None:
        commands = command_descriptions()
        near = difflib.get_close_matches(name, commands, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"allowed: {', '.join(commands)}"
        print(f"torchhand: error: unknown command {arguments[0]!r}; {hint}", file=sys.stderr)
        return 2
    try:
        if arguments[1:] in (["--help"], ["-h"]) and _print_help(name):
            return 0
        module = _loaded(f"{cli.__name__}.{name}")
    except KeyboardInterrupt:  # loading torch takes seconds: long enough to change one's mind
        print(f"torchhand {name}: stopped by Ctrl-C", file=sys.stderr)
        return 130
    return module.main(arguments[1:])


def _loaded(module: str) -> ModuleType:
    """A command's module. Nothing of what loading makes is garbage: searching it for some takes a tenth of the time."""
    if module in sys.modules:
        return sys.modules[module]
    is_collecting = gc.isenabled()
    gc.disable()
    try:
        return importlib.import_module(module)
    finally:
        gc.freeze()
        if is_collecting:
            gc.enable()


def _print_help(name: str) -> bool:
    """Print what `--help` does without loading what only the command needs; False where that cannot be."""
    from torchhand.cli.command import arguments_of, has_settings, print_help

    module = f"{cli.__name__}.{name}"
    record = arguments_of(module)
    if record is not None:
        print_help(record, name=name, has_settings=has_settings(module))
    return record is not None


def _print_completion(words: Sequence[str]) -> int:
    """Print the script that completes commands, options and their choices in a shell."""
    import tyro

    from torchhand.cli.command import arguments_of, has_settings, whole_record

    if len(words) != 1 or words[0] not in SHELLS:
        print(f"torchhand: error: {COMPLETION}: expected one of {', '.join(SHELLS)}", file=sys.stderr)
        return 2
    records: list[Any] = []
    for name in command_descriptions():
        module = f"{cli.__name__}.{name}"
        record: Any = arguments_of(module) or importlib.import_module(module).Arguments
        whole = whole_record(record, has_settings=has_settings(module))
        records.append(Annotated[whole, tyro.conf.subcommand(name, prefix_name=False)])
    try:
        any_command: Any = Union[tuple(records)]  # noqa: UP007 - made at run time
        tyro.cli(any_command, args=["--tyro-print-completion", words[0]], prog="torchhand")
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else 0
    return 0


def command_descriptions() -> dict[str, str]:
    """Names of the commands, sorted, with one line on each, without importing any of them."""
    described = {name: _description(name) for name in sorted(_files())}
    return {name: description for name, description in described.items() if description is not None}


def _files() -> set[str]:
    """Names of the files beside this one; not all of them are commands."""
    return {module.name for module in pkgutil.iter_modules(cli.__path__)} - {"main", "__main__"}


def _description(name: str) -> str | None:
    """The first line of a file's docstring; None for a file that is no command."""
    tree = ast.parse(_source(f"{cli.__name__}.{name}"))
    if not any(isinstance(node, ast.FunctionDef) and node.name == "main" for node in tree.body):
        return None
    return (ast.get_docstring(tree) or "").partition("\n")[0].strip()


def _source(module_name: str) -> str:
    loader = getattr(find_spec(module_name), "loader", None)
    return (loader.get_source(module_name) if loader else None) or ""


def _usage() -> str:
    commands = command_descriptions()
    width = max((len(name) for name in commands), default=0)
    lines = [f"  {name:<{width}}  {description}" for name, description in commands.items()]
    description = (torchhand.__doc__ or "").partition("\n")[0]
    return USAGE.format(description=description, commands="\n".join(lines))
