"""Single settings that the command line changes: --set KEY=VALUE."""

from collections.abc import Sequence
from typing import Any

from torchhand.errors import InputError
from torchhand.files.disk import read_yaml, short


def changes_of(texts: Sequence[str], example: str) -> dict[str, Any]:
    """Values by dotted key, of texts KEY=VALUE; values as in YAML. Raises InputError naming the option and the key."""
    changes: dict[str, Any] = {}
    for change in texts:
        key, is_given, text = change.partition("=")
        if not is_given or not key:
            raise InputError(f"--set: expected KEY=VALUE such as {example}, got {change!r}")
        try:
            changes[key] = read_yaml(text, f"--set {key}")
        except InputError as error:
            raise InputError(f"--set {key}: expected a value as in YAML, got {short(text)}") from error
    for key in changes:
        inside = next((other for other in changes if other.startswith(f"{key}.")), None)
        if inside is not None:
            raise InputError(f"--set: expected each field once, got {key} and {inside}")
    return changes
