"""Reading JSON that a user may have written: every mistake becomes one line naming the file and the key."""

import difflib
import json
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from torchhand.errors import InputError
from torchhand.files.disk.plain_files import read_text


def read_json(path: Path) -> Any:
    """The content of a JSON file, with or without a byte order mark.

    Raises InputError with the line number of a syntax error.
    """
    text = read_text(path, "a JSON text file", missing="no such file")
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(f"{path}, line {error.lineno}: is no valid JSON ({error.msg})") from error
    except (ValueError, RecursionError) as error:  # whole numbers of thousands of digits, lists in lists in lists
        raise InputError(f"{path}: is no JSON that can be read ({error})") from error


def read_number(where: str, value: Any) -> float:
    """A finite number; `where` names file and key."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or not abs(value) <= sys.float_info.max:  # NaN compares false
        raise InputError(f"{where}: expected a finite number, got {short(value)}")
    return float(value)


def read_numbers(where: str, value: Any, shape: tuple[int, ...]) -> list[Any]:
    """Nested lists of finite numbers of the given shape."""
    if not shape:
        return [read_number(where, value)]
    if not isinstance(value, list) or len(value) != shape[0]:
        got = f"{len(value)}" if isinstance(value, list) else short(value)
        raise InputError(f"{where}: expected a list of {shape[0]}, got {got}")
    if len(shape) == 1:
        return [read_number(f"{where}[{i}]", item) for i, item in enumerate(value)]
    return [read_numbers(f"{where}[{i}]", item, shape[1:]) for i, item in enumerate(value)]


def short(value: Any) -> str:
    """A value for an error line, cut to one screen line."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def suggestion(name: str, allowed: Iterable[str]) -> str:
    """' (did you mean x?)', or nothing."""
    close = difflib.get_close_matches(name, list(allowed), n=1)
    return f" (did you mean {close[0]}?)" if close else ""
