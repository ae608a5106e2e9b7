"""A command's record of arguments without the rest of its file, so that `--help` need not wait for torch.

Loading torch takes seconds; what a command's options are called, and what they are for, needs nothing of it.
"""

import ast
import importlib
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import torchhand

RECORD = "Arguments"
OWN = torchhand.__name__
LIGHT = frozenset(sys.stdlib_module_names) | {"tyro"}


def arguments_of(module: str) -> type | None:
    """The class `Arguments` of a command's file, made from the statements that it needs alone, and without its methods.

    None where these statements need another library than the standard one and tyro: then the file must be imported.
    """
    try:
        return _Names().value(module, RECORD)
    except _NeedsMoreError:
        return None


def has_settings(module: str) -> bool:
    """Whether a command's file gives `parse` its settings, so that the command has --print-config."""
    return any(
        isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id == "parse"
        and any(keyword.arg == "settings" for keyword in node.keywords)
        for node in ast.walk(ast.parse(_path_of(module).read_text(encoding="utf-8")))
    )


class _NeedsMoreError(Exception):
    """What is looked for cannot be had without loading whole files."""


class _Names:
    """Names of our own files, each made by executing the statement that binds it and those that this one needs."""

    def __init__(self) -> None:
        self._modules: dict[str, tuple[ModuleType, dict[str, ast.stmt]]] = {}

    def value(self, module: str, name: str) -> Any:
        """What a name of a module stands for. Raises _NeedsMoreError."""
        if module.partition(".")[0] != OWN:
            return getattr(_light_module(module), name)
        namespace, statements = self._read(module)
        if name not in vars(namespace):
            if _path_of(f"{module}.{name}").is_file():
                vars(namespace)[name] = self._read(f"{module}.{name}")[0]
            elif name in statements:
                self._bind(namespace, statements, name)
            else:
                raise _NeedsMoreError(f"{module}.{name}")
        return vars(namespace)[name]

    def _bind(self, namespace: ModuleType, statements: dict[str, ast.stmt], name: str) -> None:
        statement = statements[name]
        if isinstance(statement, ast.Import | ast.ImportFrom):
            original = next(alias.name for alias in statement.names if (alias.asname or alias.name) == name)
            is_from = isinstance(statement, ast.ImportFrom)
            found = self.value(statement.module or "", original) if is_from else _light_module(original)
            vars(namespace)[name] = found
            return
        if isinstance(statement, ast.ClassDef):
            statement.body = [one for one in statement.body if not isinstance(one, ast.FunctionDef)]
        for node in ast.walk(statement):
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load) and node.id in statements:
                self.value(namespace.__name__.partition(" ")[0], node.id)
        code = compile(ast.Module([statement], []), str(namespace.__file__), "exec")
        try:
            exec(code, vars(namespace))
        except (AttributeError, NameError) as error:  # what it reads is bound inside of something else
            raise _NeedsMoreError(f"{namespace.__name__}: {name}") from error

    def _read(self, module: str) -> tuple[ModuleType, dict[str, ast.stmt]]:
        """An empty namespace for a module, and the statements at its top by the names that they bind."""
        if module not in self._modules:
            path = _path_of(module)
            # Not the module's own name, under which the whole may be imported later. tyro reads the texts of the fields
            # from the file of the module that a class names.
            namespace = ModuleType(f"{module} (arguments alone)")
            namespace.__file__ = str(path)
            sys.modules[namespace.__name__] = namespace
            statements = {}
            for statement in ast.parse(path.read_text(encoding="utf-8")).body:
                statements |= dict.fromkeys(_names_bound_by(statement), statement)
            self._modules[module] = namespace, statements
        return self._modules[module]


def _path_of(module: str) -> Path:
    """The file of one of our modules, which need not exist."""
    path = Path(torchhand.__path__[0], *module.split(".")[1:])
    return path / "__init__.py" if path.is_dir() else path.with_suffix(".py")


def _light_module(name: str) -> ModuleType:
    if name.partition(".")[0] not in LIGHT:
        raise _NeedsMoreError(name)
    return importlib.import_module(name)


def _names_bound_by(statement: ast.stmt) -> list[str]:
    if isinstance(statement, ast.Import | ast.ImportFrom):
        return [alias.asname or alias.name for alias in statement.names]
    if isinstance(statement, ast.ClassDef | ast.FunctionDef):
        return [statement.name]
    if isinstance(statement, ast.Assign):
        return [node.id for target in statement.targets for node in ast.walk(target) if isinstance(node, ast.Name)]
    if isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name):
        return [statement.target.id]
    return []
