"""What a benchmark finds: a figure with its limits, its line in a table, and how ours is timed against a peer."""

import importlib
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

import torch

from torchhand.devices import HOST, finished
from torchhand.evaluate import time_interleaved

AT_MOST = ("MiB", "%", "rad", "ms", "kbit/s", "faults")
"""Units of which less is better."""


@dataclass(frozen=True, kw_only=True)
class Figure:
    """One measurement."""

    name: str
    value: float | None
    """Value that `must` and `aim` are about; None where it could not be measured."""
    unit: Literal["ratio", "frames/s", "IoU", "MiB", "%", "rad", "ms", "kbit/s", "faults"]
    """Unit of value, must and aim. A ratio says how many times faster than the peer ours is."""
    must: float
    """Limit that the value must reach; must not exceed where less is better (AT_MOST)."""
    aim: float | None = None
    ours_ms: float | None = None
    """Milliseconds of one call, or of one frame."""
    peer: str | None = None
    peer_ms: float | None = None
    ratio: float | None = None
    repeats: int
    note: str = ""
    details: dict[str, Any] = field(default_factory=dict)

    @property
    def meets(self) -> bool | None:
        """Whether `must` holds."""
        if self.value is None:
            return None
        return self.value < self.must if self.unit in AT_MOST else self.value >= self.must


def line_of(figure: Figure) -> str:
    """One figure as a row of the table."""
    parts = [f"{figure.name:<28}"]
    parts.append(f"{figure.ours_ms:8.2f} ms" if figure.ours_ms is not None else " " * 11)
    against = "" if figure.peer_ms is None else f"{figure.peer} {figure.peer_ms:.2f} ms"
    parts.append(f"{against:<30}")
    value = "not measured" if figure.value is None else _amount(figure.value, figure.unit)
    limits = f"must {'<' if figure.unit in AT_MOST else '>='} {_amount(figure.must, figure.unit)}"
    limits += "" if figure.aim is None else f", aim {_amount(figure.aim, figure.unit)}"
    verdict = {True: "", False: " NOT MET", None: ""}[figure.meets]
    parts.append(f"{value:<14}({limits}){verdict}")
    return "  ".join(parts) + (f"\n    {figure.note}" if figure.note else "")


def _amount(value: float, unit: str) -> str:
    if unit == "ratio":
        return f"{value:.1f}x"
    return f"{value:.0f} {unit}" if unit in ("MiB", "frames/s") else f"{value:.3g} {unit}"


@dataclass(frozen=True)
class Peer:
    """A library of others that does the same."""

    name: str
    work: float = 1.0
    """What ours does in a call over what the peer does in one, such as vertices; ratios are per piece of work."""


def against_peer(
    name: str,
    repeats: int,
    peer: Peer,
    candidates: dict[str, Callable[[], object]],
    *,
    must: float,
    aim: float,
    note: str = "",
    device: torch.device = HOST,
) -> Figure:
    """Time "ours", "peer" where it is there, and other variants of ours, on the device where they compute."""
    times = time_interleaved({side: finished(call, device) for side, call in candidates.items()}, repeats, warm_up=2)
    ours, theirs = times["ours"], times.get("peer")
    details: dict[str, Any] = {f"{side}_fastest_ms": times[side].fastest for side in times}
    for variant in times.keys() - {"ours", "peer"}:
        details[f"{variant}_ms"] = times[variant].median
        details[f"{variant}_ratio"] = None if theirs is None else peer.work * times[variant].faster_than(theirs)
    ratio = None if theirs is None else peer.work * ours.faster_than(theirs)
    return Figure(
        name=name,
        value=ratio,
        unit="ratio",
        must=must,
        aim=aim,
        ours_ms=ours.median,
        peer=peer.name,
        peer_ms=None if theirs is None else theirs.median,
        ratio=ratio,
        repeats=repeats,
        note=f"{peer.name} is not installed: nothing to compare with" if theirs is None else note,
        details=details,
    )


def peer_module(name: str) -> Any:
    """A module that need not be installed; None where it is not."""
    try:
        return importlib.import_module(name)
    except ImportError:
        return None
