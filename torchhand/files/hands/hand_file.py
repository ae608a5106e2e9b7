"""hand.json: the fitted shape of one hand."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torchhand import __version__
from torchhand.errors import InputError
from torchhand.files.disk import read_json, read_number, short, suggestion, write_text

FORMAT = "torchhand hand 1"
_SIDES = ("left", "right")


@dataclass(frozen=True, kw_only=True)
class FittedHand:
    """A hand's shape as read from a file."""

    side: str
    """Side of the hand: left or right."""
    values: dict[str, float]
    """Shape parameter by name, in the order in which the caller named them."""
    units: dict[str, str]
    """Unit by name, as the file says."""
    provenance: dict[str, Any]
    """How it was fitted: picture, camera, method."""


def save_hand(
    path: str | Path,
    names: Sequence[str],
    values: Sequence[float],
    side: str,
    provenance: Mapping[str, Any],
    *,
    units: Sequence[str] = (),
) -> None:
    """Write a fitted shape. `units` has one entry per name (m, /HL or /HB), or none: all metres."""
    if side not in _SIDES:
        raise ValueError(f"side: expected one of {', '.join(_SIDES)}, got {side!r}")
    content = {
        "format": FORMAT,
        "torchhand": __version__,
        "side": side,
        "shape": {name: float(value) for name, value in zip(names, values, strict=True)},
        "units": dict(zip(names, units or ["m"] * len(names), strict=True)),
        "provenance": dict(provenance),
    }
    write_text(Path(path), json.dumps(content, indent=1, allow_nan=False, default=str) + "\n")


def load_hand(path: str | Path, names: Sequence[str] | None = None) -> FittedHand:
    """Read a fitted shape; with `names`, the file must hold exactly these parameters.

    Raises InputError naming the file, the key, what was expected and what was got.
    """
    path = Path(path)
    content = read_json(path)
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        got = content.get("format", "a file without 'format'") if isinstance(content, dict) else content
        raise InputError(f"{path}: expected a hand file ('format': '{FORMAT}'), got {short(got)}")
    side = content.get("side")
    if side not in _SIDES:
        raise InputError(f"{path}: side: expected one of {', '.join(_SIDES)}, got {short(side)}")
    shape = content.get("shape")
    if not isinstance(shape, dict):
        raise InputError(f"{path}: shape: expected numbers by name, got {short(shape)}")
    for key in ("units", "provenance"):
        if not isinstance(content.get(key), dict):
            raise InputError(f"{path}: {key}: expected keys with values, got {short(content.get(key))}")
    for name, unit in content["units"].items():
        if not isinstance(unit, str):
            raise InputError(f"{path}: units.{name}: expected a text, got {short(unit)}")
    if names is not None:
        unknown = [name for name in shape if name not in names]
        if unknown:
            hint = suggestion(unknown[0], names)
            raise InputError(f"{path}: shape: unknown {', '.join(unknown)}{hint}; allowed: {', '.join(names)}")
        missing = [name for name in names if name not in shape]
        if missing:
            raise InputError(f"{path}: shape: lacks {', '.join(missing)}")
    values = {name: read_number(f"{path}: shape.{name}", shape[name]) for name in (shape if names is None else names)}
    return FittedHand(side=side, values=values, units=content["units"], provenance=content["provenance"])
