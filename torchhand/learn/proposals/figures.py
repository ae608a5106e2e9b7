"""How good proposals are: the likeliest of each picture and the best of all, before and after registration."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.evaluate import aligned_errors, fit_similarity, flexion_deg
from torchhand.hand import PALM

FIGURES = {
    "placed_mm": "keypoints relative to the middle of the palm, mm",
    "rotation_deg": "direction of the palm, degrees",
    "flexion_deg": "flexion, degrees",
    "aligned_mm": "keypoints after similarity alignment (PA), mm",
}
"""Errors, means over the pictures."""

_MM = 1000.0


@dataclass(frozen=True, kw_only=True)
class ProposalFigures:
    """Errors of proposals."""

    pictures: int
    top: dict[str, float]
    """Those of the likeliest (or cheapest) hypothesis of each picture."""
    best: dict[str, float]
    """Those of the hypothesis whose keypoints, relative to the middle of the palm, are nearest to the truth."""
    within: float
    """Share of the pictures where the palm's direction of the best is within 30 degrees."""


def proposal_figures(
    keypoints: Float[Tensor, "pictures k 21 3"],
    order: Float[Tensor, "pictures k"],
    truth: Float[Tensor, "pictures 21 3"],
) -> ProposalFigures:
    """order: larger is likelier; hypotheses that are not finite are left out. Pictures without any count as failed
    and are left out of the means, but not of `within`.

    Of flexion each joint's mean over the likeliest hypotheses is taken out, as in `evaluate`: hands of other makers
    call other angles straight. Of a single picture it stays.
    """
    own, true = (points.detach().double().cpu().numpy() for points in (keypoints, truth))
    is_there = np.isfinite(own).all((1, 2, 3))
    kept = own[is_there]
    shown = np.broadcast_to(true[is_there][:, None], kept.shape)
    if not len(kept):
        nothing = dict.fromkeys(FIGURES, float("nan"))
        return ProposalFigures(pictures=len(own), top=nothing, best=nothing, within=0.0)
    aligned = _MM * aligned_errors(kept, shown).mean(-1)
    arms, shown_arms = (points - points[..., list(PALM), :].mean(-2, keepdims=True) for points in (kept, shown))
    placed = _MM * np.linalg.norm(arms - shown_arms, axis=-1).mean(-1)
    turns = _rotation_deg(kept, shown)
    top = order[torch.from_numpy(is_there)].argmax(-1).numpy()
    rows = np.arange(len(kept))
    difference = flexion_deg(kept) - flexion_deg(shown)
    offset = difference[rows, top].mean(0) if len(kept) > 1 else 0.0
    flexion = np.abs(difference - offset).mean((-1, -2))
    found = {"placed_mm": placed, "rotation_deg": turns, "flexion_deg": flexion, "aligned_mm": aligned}
    best = placed.argmin(-1)
    return ProposalFigures(
        pictures=len(own),
        top={name: float(values[rows, top].mean()) for name, values in found.items()},
        best={name: float(values[rows, best].mean()) for name, values in found.items()},
        within=float((turns[rows, best] < 30).sum() / len(own)),
    )


def figures_table(rows: Sequence[tuple[str, ProposalFigures]]) -> str:
    """A line for each kind of pictures: likeliest / best of every figure."""
    head = f"{'':<44}{'pictures':>9}" + "".join(f"{name:>16}" for name in FIGURES) + f"{'within 30°':>12}"
    lines = [head]
    for name, one in rows:
        cells = "".join(f"{f'{one.top[key]:.1f} / {one.best[key]:.1f}':>16}" for key in FIGURES)
        lines.append(f"{name:<44}{one.pictures:>9}{cells}{one.within:>12.0%}")
    return "\n".join(lines)


def _rotation_deg(own: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Turn between the palms, wrist and knuckles taken as a rigid body, degrees."""
    motion = fit_similarity(own[..., list(PALM), :], true[..., list(PALM), :], with_scale=True)
    trace = np.trace(motion.rotation, axis1=-2, axis2=-1)
    return np.degrees(np.arccos(np.clip((trace - 1) / 2, -1, 1)))
