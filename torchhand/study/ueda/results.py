"""Tables and plots of `torchhand study ueda`."""

import csv
import io
import statistics
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor

from torchhand.draw import Axes, draw_chart
from torchhand.files.disk import write_text
from torchhand.study.ueda.stages import PAPER_MS, STAGES

DEFAULT_STEPS = "largest"
"""Reading of the step of Ueda et al. (2003) that the figures show."""
SOURCES = {"own": "own simulator", "data": "another maker's hand"}

_CURVES = ("error_deg", "inside_fraction", "within_fraction")

Rows = list[dict[str, Any]]


def convergence_rows(parts: Mapping[str, Any]) -> Rows:
    """A row per source, level, reading and iteration."""
    return [
        {
            "source": part["source"],
            "level": part["level"],
            "steps": part["steps"],
            "iteration": iteration,
            "error_deg": error,
            "inside_fraction": inside,
            "within_fraction": within,
        }
        for part in _of(parts, "converge")
        for iteration, (error, inside, within) in enumerate(zip(*(part[key] for key in _CURVES), strict=True))
    ]


def stage_rows(parts: Mapping[str, Any]) -> Rows:
    """A row per source and stage, and what the paper printed."""
    return [
        {
            "source": part["source"],
            "level": part["level"],
            "stage": name,
            "ms": part["ms"][name],
            "paper_ms": PAPER_MS.get(name, ""),
        }
        for part in _of(parts, "stages")
        for name in STAGES
    ]


def comparison_rows(parts: Mapping[str, Any]) -> Rows:
    """A row per method and number of cameras: medians over the people, and the worst of them."""
    found: dict[tuple[int, str], list[dict[str, float]]] = {}
    for part in _of(parts, "compare"):
        for method, errors in part["errors"].items():
            found.setdefault((part["cameras"], method), []).append(errors)
    rows = []
    for (cameras, method), errors in sorted(found.items(), key=lambda item: item[0][0]):
        row: dict[str, Any] = {"method": method, "cameras": cameras, "people": len(errors)}
        for name in ("joint_mm", "flexion_deg", "milliseconds"):
            values = [one[name] for one in errors]
            row |= {f"{name}_median": statistics.median(values), f"{name}_worst": max(values)}
        rows.append(row)
    return rows


def printed(parts: Mapping[str, Any]) -> str:
    """What the terminal shows."""
    lines = []
    for source, title in SOURCES.items():
        found = [part for part in _of(parts, "converge") if part["source"] == source]
        if found:
            lines.append(f"{title}: error of the index after {len(found[0]['error_deg']) - 1} iterations, degrees")
        for steps in dict.fromkeys(part["steps"] for part in found):
            ends = "  ".join(
                f"level {one['level']}: {one['error_deg'][-1]:5.2f} ({100 * one['inside_fraction'][-1]:.1f} % inside)"
                for one in found
                if one["steps"] == steps
            )
            lines.append(f"  {steps:<13} {ends}")
    for part in _of(parts, "stages"):
        times = ", ".join(f"{name} {part['ms'][name]:.1f}" for name in STAGES)
        lines.append(f"{SOURCES[part['source']]}: ms at level {part['level']}: {times}")
    rows = comparison_rows(parts)
    if rows:
        lines.append("joint error in mm, flexion error in degrees, ms of the fit (medians over people)")
    methods = list(dict.fromkeys(row["method"] for row in rows))
    width = max(map(len, methods), default=0)
    for row in rows:
        lines.append(
            f"  {row['cameras']} cameras  {row['method']:<{width}}  {row['joint_mm_median']:6.2f}"
            f"  {row['flexion_deg_median']:6.2f}  {row['milliseconds_median']:7.1f}"
        )
    return "\n".join(lines)


_CONVERGENCE, _COMPARISON = ("figure13.png", "figure14.png"), "comparison.png"
RESULT_NAMES = ("convergence.csv", "stages.csv", "comparison.csv", *_CONVERGENCE, _COMPARISON)
"""Of all that `write_results` can write."""


def write_results(folder: Path, parts: Mapping[str, Any]) -> None:
    """CSV files and plots of what there is."""
    tables = {
        "convergence": convergence_rows(parts),
        "stages": stage_rows(parts),
        "comparison": comparison_rows(parts),
    }
    for name, rows in tables.items():
        if rows:
            write_text(folder / f"{name}.csv", csv_text(rows))
    if tables["convergence"]:
        _write_picture(
            folder / _CONVERGENCE[0], _figure(parts, "error_deg", "error of the index, degrees", lambda error: error)
        )
        _write_picture(
            folder / _CONVERGENCE[1],
            _figure(parts, "inside_fraction", "vertices outside, %", lambda inside: 100 * (1 - inside)),
        )
    if tables["comparison"]:
        _write_picture(folder / _COMPARISON, _comparison(tables["comparison"]))


def csv_text(rows: Rows) -> str:
    """Text with a heading; floats to six digits."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow({key: f"{value:.6g}" if isinstance(value, float) else value for key, value in row.items()})
    return text.getvalue()


def _figure(
    parts: Mapping[str, Any], key: str, title: str, shown: Callable[[float], float]
) -> UInt8[Tensor, "height width 3"]:
    """A chart per source, a line per level. Vertices outside are what the paper's rate lacks of 100 %."""
    charts = []
    for source, name in SOURCES.items():
        found = [p for p in _of(parts, "converge") if p["source"] == source and p["steps"] == DEFAULT_STEPS]
        if not found:
            continue
        lines = {f"level {part['level']}": [shown(value) for value in part[key]] for part in found}
        count = len(next(iter(lines.values())))
        charts.append(draw_chart(Axes(f"{title}: {name}", x_name="iteration"), list(range(count)), lines))
    return torch.cat(charts, 1)


def _comparison(rows: Rows) -> UInt8[Tensor, "height width 3"]:
    """Errors over the number of cameras, a line per method."""
    counts = sorted({row["cameras"] for row in rows})
    methods = list(dict.fromkeys(row["method"] for row in rows))
    charts = []
    for key, title in (
        ("joint_mm_median", "median joint error, mm"),
        ("flexion_deg_median", "median flexion error, deg"),
    ):
        value = {(row["method"], row["cameras"]): row[key] for row in rows}
        lines = {method: [value.get((method, count), float("nan")) for count in counts] for method in methods}
        charts.append(draw_chart(Axes(title, x_name="cameras", size_px=(560, 320)), counts, lines, has_dots=True))
    return torch.cat(charts, 1)


def _of(parts: Mapping[str, Any], kind: str) -> Sequence[dict[str, Any]]:
    return [part for part in parts.values() if part["kind"] == kind]


def _write_picture(path: Path, picture: Tensor) -> None:
    _, encoded = cv2.imencode(".png", cv2.cvtColor(np.ascontiguousarray(picture.numpy()), cv2.COLOR_RGB2BGR))
    path.write_bytes(encoded.tobytes())  # so that the system says why it refuses
