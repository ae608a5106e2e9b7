"""The plot of a designed study: success over every factor, with Wilson's intervals (matplotlib, extra `study`)."""

import importlib
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from torchhand.errors import InputError
from torchhand.study.designed.designs import OneAtATime
from torchhand.study.designed.study import Study, text_of
from torchhand.study.designed.table import CellRow
from torchhand.study.hypotheses import wilson_interval

_BINS = 6  # of the values that a Latin hypercube draws
_PANEL = (3.6, 3.0)  # inches
_PERCENT = 100.0


def require_matplotlib() -> None:
    """Raise InputError of one line where matplotlib is missing."""
    try:
        importlib.import_module("matplotlib")
    except ImportError as error:
        raise InputError("the plot of a study needs matplotlib: pip install 'torchhand[study]'") from error


def draw_study(study: Study, rows: Sequence[CellRow], path: Path) -> None:
    """Write the plot, PNG: for every factor success above and errors below, a line per level of the crossed factor.

    Trials of equal values are taken together. The other factors are pooled, but those of a one-at-a-time design, which
    are at their first levels.
    """
    require_matplotlib()
    figure_module: Any = importlib.import_module("matplotlib.figure")
    names = [name for name in study.factors if name != study.crossed] or list(study.factors)
    size = (_PANEL[0] * max(2, len(names)), 2 * _PANEL[1] + 0.3)
    figure = figure_module.Figure(figsize=size, layout="constrained", dpi=80)
    panels = figure.subplots(2, len(names), squeeze=False, sharex="col", sharey="row")
    for column, name in enumerate(names):
        above, below = panels[:, column]
        for level in _levels(study):
            _draw_line(above, below, study, rows, name, level)
        below.set(xlabel=name)
        for axes in (above, below):
            axes.grid(alpha=0.3)
            axes.spines[["top", "right"]].set_visible(False)
    panels[0, 0].set(ylabel=f"success (joints within {study.success_deg:g}°), %", ylim=(0, 102))
    panels[1, 0].set(ylabel="median keypoint error, mm", ylim=(0, None))
    if study.crossed in study.factors and study.crossed not in names:
        handles, labels = panels[0, 0].get_legend_handles_labels()
        figure.legend(
            handles, labels, loc="outside upper center", ncols=len(labels), title=study.crossed, frameon=False
        )
    figure.savefig(path, format="png", metadata={"Software": None})


def _levels(study: Study) -> list[Any]:
    """Texts of the levels of the crossed factor; None alone where there is none."""
    if study.crossed is None:
        return [None]
    return list(dict.fromkeys(text_of(cell.values[study.crossed]) for cell in study.cells))


def _draw_line(above: Any, below: Any, study: Study, rows: Sequence[CellRow], name: str, level: Any) -> None:
    chosen = [
        (text_of(cell.values[name]), row)
        for cell, row in zip(study.cells, rows, strict=True)
        if level is None or text_of(cell.values[str(study.crossed)]) == level
        if not isinstance(study.design, OneAtATime) or _is_alone(study, cell.values, name)
    ]
    found = _pooled(chosen)
    x = [place for place, _ in found]
    shares = [sum(row.successes for row in own) / sum(row.trials for row in own) for _, own in found]
    ends = [wilson_interval(sum(row.successes for row in own), sum(row.trials for row in own)) for _, own in found]
    label = f"{level:g}" if isinstance(level, (int, float)) else level
    lower = [max(0.0, _PERCENT * (share - low)) for share, (low, _) in zip(shares, ends, strict=True)]
    upper = [max(0.0, _PERCENT * (high - share)) for share, (_, high) in zip(shares, ends, strict=True)]
    style = {"marker": "o", "ms": 4, "lw": 1.3, "label": label}
    above.errorbar(x, [_PERCENT * share for share in shares], (lower, upper), capsize=2, **style)
    below.plot(x, [sum(row.keypoint_median_mm for row in own) / len(own) for _, own in found], **style)


def _is_alone(study: Study, values: Any, name: str) -> bool:
    """Whether all other factors are at their first levels."""
    first = study.cells[0].values
    others = [other for other in study.factors if other not in (name, study.crossed)]
    return all(text_of(values[other]) == text_of(first[other]) for other in others)


def _pooled(chosen: Sequence[tuple[Any, CellRow]]) -> list[tuple[Any, list[CellRow]]]:
    """Rows of equal values together; of many different numbers those in one of some bins, at the bin's mean."""
    values = list(dict.fromkeys(value for value, _ in chosen))
    if not all(isinstance(value, (int, float)) for value in values):
        return [(str(value), [row for own, row in chosen if own == value]) for value in values]
    if len(values) <= 2 * _BINS:
        return [(value, [row for own, row in chosen if own == value]) for value in sorted(values)]
    ordered = sorted(chosen, key=lambda pair: pair[0])
    size = math.ceil(len(ordered) / _BINS)
    bins = [ordered[first : first + size] for first in range(0, len(ordered), size)]
    return [(sum(value for value, _ in one) / len(one), [row for _, row in one]) for one in bins]
