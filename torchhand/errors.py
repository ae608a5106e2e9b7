"""What the user gave is wrong: the one exception for input from outside, the one check of settings."""

import math


class InputError(Exception):
    """Bad input from outside (a file, a flag, a picture): one line that says what, what was expected, got and allowed.

    The commands print the line and leave with exit code 2; everything else is a defect and keeps its traceback.
    """


class DiskError(InputError):
    """The disk is full or failing: no mistake of the user's input. The commands leave with exit code 1."""


def require(condition: bool, name: str, expected: str, got: object) -> None:
    """Raise ValueError naming a setting, what was expected and what was given, unless the condition holds."""
    if not condition:
        raise ValueError(f"{name}: expected {expected}, got {got!r}")


def require_kind(name: str, value: object, *kinds: type) -> None:
    """Raise TypeError naming an argument, what was expected and what was given, unless it is of one of the kinds."""
    if not isinstance(value, kinds):
        raise TypeError(f"{name}: expected {' or '.join(kind.__name__ for kind in kinds)}, got {type(value).__name__}")


def require_positive(name: str, value: float) -> None:
    """Raise ValueError unless a setting is above 0 and finite."""
    require(0 < value < math.inf, name, "above 0 and finite", value)
