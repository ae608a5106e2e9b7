"""A hypothesis study in rows: success, errors and statuses for every size of the perturbation."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from torchhand.study.hypotheses.proportions import quantile_with_failures, success_of_best, wilson_interval
from torchhand.study.hypotheses.record import STATUS_NAMES, Hypotheses
from torchhand.study.hypotheses.settings import HypothesisStudySettings

ALL_FRAMES = "all"


@dataclass(frozen=True, kw_only=True)
class StudyRow:
    """One size of the perturbation, in one frame or in all. Quantiles count failures as infinite errors."""

    frame: str
    """Number, or "all"."""
    size: float
    """Share of the largest perturbation."""
    angle_deg: float
    """The largest perturbation of this size: of joint angles, of the wrist's coordinates, and of the orientation."""
    translation_mm: float
    rotation_deg: float
    starts: int
    success: float
    """Share of the starts."""
    success_low: float
    """Wilson's 95 % interval."""
    success_high: float
    start_success: float
    """Fraction of the starts that were successes before they were registered."""
    start_angle_median_deg: float
    angle_median_deg: float
    angle_p90_deg: float
    start_keypoint_median_mm: float
    keypoint_median_mm: float
    keypoint_p90_mm: float
    start_rotation_median_deg: float
    rotation_median_deg: float
    rotation_p90_deg: float
    contour_median_px: float
    contour_p90_px: float
    statuses: tuple[float, ...]
    """Shares, in the order of STATUS_NAMES."""
    best_of: tuple[float, ...]
    """Success of the one of so many starts that explains the picture best, as the settings list them; NaN where there
    are not so many."""

    @property
    def failed(self) -> float:
        """Share of the starts that could not be registered."""
        return sum(fraction for name, fraction in zip(STATUS_NAMES, self.statuses, strict=True) if name in _FAILURES)


_FAILURES = ("failed", "no_data")


def study_rows(hypotheses: Hypotheses, settings: HypothesisStudySettings) -> list[StudyRow]:
    """A row per size over all frames, the smallest first; then, of several frames, the same of each."""
    frames = list(dict.fromkeys(hypotheses.frame.tolist()))
    groups: list[tuple[str, list[int]]] = [(ALL_FRAMES, frames)]
    if len(frames) > 1:
        groups += [(str(frame), [frame]) for frame in frames]
    return [
        _row(name, own, level, hypotheses, settings)
        for name, own in groups
        for level in range(1, settings.perturbation.levels + 1)
    ]


def _row(
    name: str, frames: Sequence[int], level: int, hypotheses: Hypotheses, settings: HypothesisStudySettings
) -> StudyRow:
    own = hypotheses.select((hypotheses.level == level) & np.isin(hypotheses.frame, frames))
    count, size = len(own), level / settings.perturbation.levels
    is_success = own.is_success(settings.success_deg)
    low, high = wilson_interval(int(is_success.sum()), count)

    def quantiles(values: np.ndarray) -> tuple[float, float]:
        return quantile_with_failures(values, 0.5), quantile_with_failures(values, 0.9)

    angle, keypoint = quantiles(own.angle_deg), quantiles(own.keypoint_mm)
    rotation, contour = quantiles(own.rotation_deg), quantiles(own.contour_px)
    return StudyRow(
        frame=name,
        size=size,
        angle_deg=size * settings.perturbation.angle_deg,
        translation_mm=size * settings.perturbation.translation_mm,
        rotation_deg=size * settings.perturbation.rotation_deg,
        starts=count,
        success=float(is_success.mean()) if count else float("nan"),
        success_low=low,
        success_high=high,
        start_success=float((own.start_angle_deg <= settings.success_deg).mean()) if count else float("nan"),
        start_angle_median_deg=quantile_with_failures(own.start_angle_deg, 0.5),
        angle_median_deg=angle[0],
        angle_p90_deg=angle[1],
        start_keypoint_median_mm=quantile_with_failures(own.start_keypoint_mm, 0.5),
        keypoint_median_mm=keypoint[0],
        keypoint_p90_mm=keypoint[1],
        start_rotation_median_deg=quantile_with_failures(own.start_rotation_deg, 0.5),
        rotation_median_deg=rotation[0],
        rotation_p90_deg=rotation[1],
        contour_median_px=contour[0],
        contour_p90_px=contour[1],
        statuses=tuple(float((own.status == i).sum()) / max(1, count) for i in range(len(STATUS_NAMES))),
        best_of=tuple(_best_of(own, is_success, tries) for tries in settings.best_of),
    )


def _best_of(own: Hypotheses, is_success: np.ndarray, tries: int) -> float:
    """Mean over the frames: misfits of different pictures do not compare."""
    per_frame = [
        success_of_best(own.misfit[own.frame == frame], is_success[own.frame == frame], tries)
        for frame in np.unique(own.frame)
    ]
    return float(np.mean(per_frame)) if per_frame else float("nan")


def csv_text(rows: Sequence[StudyRow], settings: HypothesisStudySettings) -> str:
    """The rows as comma-separated values with a line of names."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    plain = [name for name in StudyRow.__dataclass_fields__ if name not in ("statuses", "best_of")]
    table.writerow((*plain, *STATUS_NAMES, *(f"best_of_{tries}" for tries in settings.best_of)))
    for row in rows:
        values = [getattr(row, name) for name in plain] + [*row.statuses, *row.best_of]
        table.writerow(f"{value:.6g}" if isinstance(value, float) else value for value in values)
    return text.getvalue()


def printed_table(rows: Sequence[StudyRow], settings: HypothesisStudySettings) -> str:
    """The rows over all frames, for a terminal."""
    tries = settings.best_of[-1]
    head = (
        f"{'perturbation':<22}{'starts':>7}  {'success (95 %)':<25}{f'best of {tries}':>10}{'failed':>8}"
        f"  {'joint error':<16}{'keypoints':<12}"
    )
    lines = [head, f"{'':<76}{'median, 90 %':<16}{'median, 90 %':<12}"]
    for row in rows:
        if row.frame != ALL_FRAMES:
            continue
        moved = f"±{row.angle_deg:.3g}° ±{row.translation_mm:.3g} mm ±{row.rotation_deg:.3g}°"
        interval = f"{row.success:6.1%} ({row.success_low:.1%} to {row.success_high:.1%})"
        angles = f"{row.angle_median_deg:.2f}°, {row.angle_p90_deg:.2f}°"
        points = f"{row.keypoint_median_mm:.1f}, {row.keypoint_p90_mm:.1f} mm"
        best = "-" if np.isnan(row.best_of[-1]) else f"{row.best_of[-1]:.1%}"
        lines.append(f"{moved:<22}{row.starts:>7}  {interval:<25}{best:>10}{row.failed:>8.1%}  {angles:<16}{points}")
    return "\n".join(lines)
