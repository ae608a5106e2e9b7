"""The outcomes of a designed study, a row per cell."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from torchhand.fit import SolveStatus
from torchhand.study.designed.study import Cell, Study, text_of
from torchhand.study.hypotheses import Hypotheses, quantile_with_failures, wilson_interval

_PRINTED = 40


@dataclass(frozen=True, kw_only=True)
class CellRow:
    """What became of a cell's trials. Quantiles count failures as infinite errors; intervals are Wilson's, 95 %."""

    trials: int
    successes: int
    success: float
    """Share of the trials whose mean joint error is small enough."""
    success_low: float
    success_high: float
    converged: float
    """Share of the trials whose solver converged."""
    converged_low: float
    converged_high: float
    angle_median_deg: float
    angle_p90_deg: float
    keypoint_median_mm: float
    keypoint_p90_mm: float
    rotation_median_deg: float
    rotation_p90_deg: float


def best_of_trials(hypotheses: Hypotheses, tries: int) -> Hypotheses:
    """Of every so many starts in a row the one that explains the observations best."""
    misfit = hypotheses.misfit.reshape(-1, tries)
    chosen = np.arange(len(misfit)) * tries + misfit.argmin(1)
    return Hypotheses(**{f.name: getattr(hypotheses, f.name)[chosen] for f in fields(Hypotheses)})


def cell_rows(study: Study, hypotheses: Hypotheses) -> list[CellRow]:
    """A row for every cell, in their order."""
    cell_of_start = hypotheses.batch // study.pictures
    return [_row(study, cell, hypotheses.select(cell_of_start == cell.index)) for cell in study.cells]


def _row(study: Study, cell: Cell, own: Hypotheses) -> CellRow:
    best = best_of_trials(own, cell.trial.hypotheses)
    count, is_success = len(best), best.is_success(study.success_deg)
    is_converged = best.status == SolveStatus.CONVERGED.value
    interval, of_converged = (
        wilson_interval(int(is_success.sum()), count),
        wilson_interval(int(is_converged.sum()), count),
    )

    def quantiles(values: np.ndarray) -> tuple[float, float]:
        return quantile_with_failures(values, 0.5), quantile_with_failures(values, 0.9)

    angle, keypoint, rotation = (quantiles(one) for one in (best.angle_deg, best.keypoint_mm, best.rotation_deg))
    return CellRow(
        trials=count,
        successes=int(is_success.sum()),
        success=float(is_success.mean()),
        success_low=interval[0],
        success_high=interval[1],
        converged=float(is_converged.mean()),
        converged_low=of_converged[0],
        converged_high=of_converged[1],
        angle_median_deg=angle[0],
        angle_p90_deg=angle[1],
        keypoint_median_mm=keypoint[0],
        keypoint_p90_mm=keypoint[1],
        rotation_median_deg=rotation[0],
        rotation_p90_deg=rotation[1],
    )


def csv_text(study: Study, rows: Sequence[CellRow]) -> str:
    """The rows as comma-separated values, each with its cell and the values of the factors."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    names = [one.name for one in fields(CellRow)]
    table.writerow(("cell", *study.factors, *names))
    for cell, row in zip(study.cells, rows, strict=True):
        values = [text_of(cell.values[name]) for name in study.factors] + [getattr(row, name) for name in names]
        table.writerow((cell.index, *(f"{one:.6g}" if isinstance(one, float) else one for one in values)))
    return text.getvalue()


def printed_table(study: Study, rows: Sequence[CellRow]) -> str:
    """The rows for a terminal; of many cells the first ones."""
    names = list(study.factors)
    head = [*names, "trials", "success (95 %)", "joint error", "keypoints"]
    lines = [head]
    for cell, row in list(zip(study.cells, rows, strict=True))[:_PRINTED]:
        values = [text_of(cell.values[name]) for name in names]
        lines.append(
            [
                *(f"{one:.3g}" if isinstance(one, float) else str(one) for one in values),
                str(row.trials),
                f"{row.success:.1%} ({row.success_low:.1%} to {row.success_high:.1%})",
                f"{row.angle_median_deg:.2f}, {row.angle_p90_deg:.2f} deg",
                f"{row.keypoint_median_mm:.1f}, {row.keypoint_p90_mm:.1f} mm",
            ]
        )
    widths = [max(len(line[i]) for line in lines) for i in range(len(head))]
    text = "\n".join(
        "  ".join(one.ljust(width) for one, width in zip(line, widths, strict=True)).rstrip() for line in lines
    )
    left = len(rows) - _PRINTED
    return text if left <= 0 else f"{text}\n... and {left} more cells"
