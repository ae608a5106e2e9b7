"""The plot of a hypothesis study: success and errors by the size of the perturbation, and what more starts give."""

from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import UInt8
from torch import Tensor

from torchhand.draw import Axes, draw_chart
from torchhand.study.hypotheses.settings import HypothesisStudySettings
from torchhand.study.hypotheses.table import ALL_FRAMES, StudyRow

_WIDTH, _HEIGHT = 600, 380
_PERCENT = 100.0


def draw_study(rows: Sequence[StudyRow], settings: HypothesisStudySettings) -> UInt8[Tensor, "height width 3"]:
    """Four charts over all frames, RGB."""
    shown = [row for row in rows if row.frame == ALL_FRAMES]
    largest = settings.perturbation
    size = [_PERCENT * row.size for row in shown]
    limits = f"{largest.angle_deg:g} deg, {largest.translation_mm:g} mm, {largest.rotation_deg:g} deg"
    x_name = f"size of the perturbation, % of {limits}"

    def chart(title: str, lines: dict[str, list[float]], y_end: float | None = None, **options: Any) -> Tensor:
        axes = Axes(title, x_name=x_name, y_end=y_end, size_px=(_WIDTH, _HEIGHT))
        return draw_chart(axes, size, lines, has_dots=True, **options)

    def percent(name: str) -> list[float]:
        return [_PERCENT * getattr(row, name) for row in shown]

    def plain(name: str) -> list[float]:
        return [getattr(row, name) for row in shown]

    best = {
        f"best of {tries}": [_PERCENT * row.best_of[i] for row in shown]
        for i, tries in enumerate(settings.best_of)
        if tries > 1
    }
    count = sum(row.starts for row in shown)
    success = chart(
        f"success, % (mean joint error up to {settings.success_deg:g} deg; {count} starts)",
        {"registered (95 %)": percent("success"), **best, "start itself": percent("start_success")},
        bands={"registered (95 %)": (percent("success_low"), percent("success_high"))},
        y_end=_PERCENT,
    )
    angles = chart(
        "mean joint error, deg",
        {
            "start, median": plain("start_angle_median_deg"),
            "registered, median": plain("angle_median_deg"),
            "registered, 90 %": plain("angle_p90_deg"),
        },
        levels={"success": settings.success_deg},
    )
    points = chart(
        "mean keypoint error, mm",
        {
            "start, median": plain("start_keypoint_median_mm"),
            "registered, median": plain("keypoint_median_mm"),
            "registered, 90 %": plain("keypoint_p90_mm"),
        },
    )
    turns = chart(
        "error of the orientation, deg",
        {
            "start, median": plain("start_rotation_median_deg"),
            "registered, median": plain("rotation_median_deg"),
            "registered, 90 %": plain("rotation_p90_deg"),
        },
    )
    return torch.cat((torch.cat((success, angles), 1), torch.cat((points, turns), 1)))
