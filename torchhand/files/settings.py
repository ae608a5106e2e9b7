"""Settings: dataclasses with defaults in Python, differences in YAML, single fields on the command line."""

import dataclasses
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import yaml

from torchhand import __version__
from torchhand.errors import InputError
from torchhand.files.disk import opened_arrays, read_plain_file, read_yaml, short, suggestion, write_text

Settings = TypeVar("Settings")

RUN_KEY = "run"
"""Top-level key of a saved file that tells how it was made; skipped when such a file is loaded again."""
CONFIG_ARRAY = "config"
"""Array of an .npz result that holds its settings as text."""
COMMAND_LINE = "command line"
_LARGEST_BYTES = 1 << 20


def load_settings(
    defaults: Settings, path: str | Path | None = None, overrides: Mapping[str, Any] | None = None
) -> Settings:
    """The defaults with the differences of a YAML file, and then of `overrides`.

    `defaults` is an instance of a dataclass, which may hold others. Overrides are nested mappings or dotted names, such
    as {"filter.order": 2}. A file that `save_settings` wrote loads as well, and so does a result (.npz) that
    holds such text.

    Raises InputError naming the file (or the command line) and the key: syntax, unknown key, wrong type, impossible
    value.
    """
    settings = defaults
    if path is not None:
        differences = _read_yaml(Path(path))
        differences.pop(RUN_KEY, None)
        settings = _changed(settings, differences, str(path), "")
    if overrides:
        settings = _changed(settings, _nested(overrides), COMMAND_LINE, "")
    return settings


def setting_in(path: str | Path, key: str) -> Any:
    """What a YAML file gives for a top-level key, unchecked; None where it gives nothing. Raises as `load_settings`."""
    return _read_yaml(Path(path)).get(key)


def save_settings(settings: Any, path: str | Path, extra: Mapping[str, Any] | None = None) -> None:
    """Write every field, resolved, and under `run` the version and what else the caller knows (seed, input ...)."""
    write_text(Path(path), settings_text(settings, extra or {}))


def settings_text(settings: Any, extra: Mapping[str, Any] | None = None) -> str:
    """Every field, resolved, as YAML that `load_settings` reads. extra: what is told under `run` beside the version;
    None for nothing."""
    content = _plain(settings)
    if extra is not None:
        if RUN_KEY in content:
            raise ValueError(f"settings: the field name {RUN_KEY!r} is reserved")
        content[RUN_KEY] = {"torchhand": __version__, **_plain(dict(extra))}
    return yaml.safe_dump(content, sort_keys=False, allow_unicode=True)


def _read_yaml(path: Path) -> dict[str, Any]:
    text = _text_in_result(path) if path.suffix.lower() == ".npz" else _text_of_file(path)
    content = read_yaml(text, str(path))
    if content is None:
        return {}
    if not isinstance(content, dict):
        raise InputError(f"{path}: expected keys with values, got {short(content)}")
    return content


def _text_of_file(path: Path) -> str:
    try:
        return read_plain_file(path, largest=_LARGEST_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: expected a YAML text file in UTF-8, got something else") from error


def _text_in_result(path: Path) -> str:
    with opened_arrays(path, complaint="is no result that can be read") as stored:
        found = stored.chosen([CONFIG_ARRAY]).get(CONFIG_ARRAY)
    if found is None or found.dtype.kind != "U" or found.ndim:
        raise InputError(f"{path}: expected a result with its settings ({CONFIG_ARRAY!r}), found none")
    return str(found)


def _nested(overrides: Mapping[str, Any]) -> dict[str, Any]:
    nested: dict[str, Any] = {}
    for key, value in overrides.items():
        *parents, last = key.split(".")
        level = nested
        for parent in parents:
            level = level.setdefault(parent, {})
        if isinstance(value, Mapping) and isinstance(level.get(last), dict):
            level[last].update(_nested(value))
        else:
            level[last] = _nested(value) if isinstance(value, Mapping) else value
    return nested


def _changed(settings: Any, differences: Any, source: str, prefix: str) -> Any:
    """A copy of a dataclass instance with some fields changed; `prefix` is the dotted path to it, for messages."""
    if not isinstance(differences, dict):
        fields = ", ".join(field.name for field in dataclasses.fields(settings))
        raise InputError(f"{source}: {prefix[:-1]}: expected keys among {fields}, got {short(differences)}")
    hints = typing.get_type_hints(type(settings))
    allowed = [field.name for field in dataclasses.fields(settings) if field.init]
    changes = {}
    for key, value in differences.items():
        if key not in allowed:
            hint = suggestion(str(key), allowed)
            raise InputError(f"{source}: unknown key {prefix}{key}{hint}; allowed: {', '.join(allowed)}")
        current = getattr(settings, key)
        may_be_none = type(None) in typing.get_args(hints[key])
        if dataclasses.is_dataclass(current) and not (value is None and may_be_none):
            changes[key] = _changed(current, value, source, f"{prefix}{key}.")
        else:
            changes[key] = _converted(f"{source}: {prefix}{key}", value, hints[key])
    try:
        return dataclasses.replace(settings, **changes)
    except ValueError as error:
        raise InputError(f"{source}: {prefix}{_of_own_field(str(error), allowed)}") from error


def _of_own_field(text: str, fields: list[str]) -> str:
    """What a record says of one of its fields, which may begin with the record's own name, without that."""
    name, colon, rest = text.partition(":")
    last = name.rpartition(".")[2]
    return f"{last}{colon}{rest}" if last in fields else text


def _converted(where: str, value: Any, hint: Any) -> Any:
    """`value`, as YAML gives it, as the annotated type; InputError where it does not fit."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if hint is Any:
        return value
    if isinstance(hint, type) and dataclasses.is_dataclass(hint) and isinstance(value, dict):
        source, _, name = where.rpartition(": ")
        return _changed(_begun(hint, value, source, f"{name}."), value, source, f"{name}.")
    if origin is typing.Literal:
        if not any(value == choice and type(value) is type(choice) for choice in arguments):
            raise InputError(f"{where}: expected one of {', '.join(map(str, arguments))}, got {short(value)}")
        return value
    if origin in (typing.Union, types.UnionType):
        return _converted_union(where, value, arguments)
    if origin in (tuple, list) and isinstance(value, list | tuple):
        is_fixed = origin is tuple and arguments[-1:] != (...,)
        if is_fixed and len(value) != len(arguments):
            raise InputError(f"{where}: expected {len(arguments)} values, got {len(value)}")
        kinds = arguments if is_fixed else [arguments[0]] * len(value)
        pairs = enumerate(zip(value, kinds, strict=True))
        return origin(_converted(f"{where}[{i}]", item, kind) for i, (item, kind) in pairs)
    if origin in (dict, Mapping) and isinstance(value, dict):
        return {str(key): _converted(f"{where}.{key}", item, arguments[1]) for key, item in value.items()}
    return _converted_plain(where, value, hint)


def _begun(kind: Any, values: dict[Any, Any], source: str, prefix: str) -> Any:
    """An instance of a dataclass with its defaults, and of `values` those fields that have none."""
    hints, missing = typing.get_type_hints(kind), dataclasses.MISSING
    needed = [f.name for f in dataclasses.fields(kind) if f.default is missing and f.default_factory is missing]
    for name in needed:
        if name not in values:
            raise InputError(f"{source}: {prefix}{name}: expected a value, it has no default; got none")
    try:
        return kind(**{name: _converted(f"{source}: {prefix}{name}", values[name], hints[name]) for name in needed})
    except ValueError as error:
        raise InputError(f"{source}: {prefix}{error}") from error


def _converted_union(where: str, value: Any, kinds: tuple[Any, ...]) -> Any:
    if value is None and type(None) in kinds:
        return None
    complaints = []
    for kind in kinds:
        if kind is type(None):
            continue
        try:
            return _converted(where, value, kind)
        except InputError as complaint:
            complaints.append(str(complaint))
    raise InputError(complaints[0] if len(complaints) == 1 else _mismatch(where, value, kinds))


def _converted_plain(where: str, value: Any, hint: Any) -> Any:
    if hint is float and isinstance(value, int | float | str) and not isinstance(value, bool):
        try:
            return float(value)  # YAML reads 1e-3 as text
        except (ValueError, OverflowError):
            pass
    elif hint is Path and isinstance(value, str):
        return Path(value)
    elif isinstance(hint, type) and type(value) is hint:
        return value
    raise InputError(_mismatch(where, value, (hint,)))


_WORDS = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "a text",
    Path: "a path",
    tuple: "a list",
    list: "a list",
    dict: "keys with values",
    type(None): "nothing (null)",
}


def _mismatch(where: str, value: Any, kinds: tuple[Any, ...]) -> str:
    words = [
        "keys with values" if dataclasses.is_dataclass(kind) else _WORDS.get(typing.get_origin(kind) or kind, str(kind))
        for kind in kinds
    ]
    return f"{where}: expected {' or '.join(words)}, got {short(value)}"


def _plain(value: Any) -> Any:
    """The value as YAML's safe types."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: _plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return str(value)
