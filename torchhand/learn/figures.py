"""How good estimated hands are, and how good one constant hand would be."""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.evaluate import aligned_errors, fit_similarity, flexion_deg, root_relative_errors, without_offset
from torchhand.learn.network import PoseNetwork

MM_PER_M = 1000.0

Figures = dict[str, float]

FIGURES = {
    "flexion_deg": "flexion error, degrees",
    "flexion_without_offset_deg": "flexion error without each joint's mean, degrees",
    "root_relative_mm": "keypoint error relative to the wrist, mm",
    "aligned_mm": "keypoint error after similarity alignment (PA), mm",
}
"""Names of the figures and what they are; means over hands and joints."""


def figures_of(estimate: Float[Tensor, "hands 21 3"], truth: Float[Tensor, "hands 21 3"]) -> Figures:
    """Errors of keypoints in metres, by the names of FIGURES."""
    own, true = (points.detach().double().cpu().numpy() for points in (estimate, truth))
    flexion = flexion_deg(own) - flexion_deg(true)
    return {
        "flexion_deg": float(np.abs(flexion).mean()),
        "flexion_without_offset_deg": float(np.nanmean(np.abs(without_offset(flexion)))) if len(own) > 1 else 0.0,
        "root_relative_mm": MM_PER_M * float(root_relative_errors(own, true).mean()),
        "aligned_mm": MM_PER_M * float(aligned_errors(own, true).mean()),
    }


def baseline_of(network: PoseNetwork, truth: Float[Tensor, "hands 21 3"], *, is_left: bool = False) -> Figures:
    """Errors of the network's usual hand, the mean posture of what it was trained on, whatever is seen.

    It is turned as fits the truth best, which is more than it could know.
    """
    usual = network.usual_keypoints().detach().double().cpu().numpy()
    true = truth.detach().double().cpu().numpy()
    if is_left:
        usual = usual * (-1.0, 1.0, 1.0)
    placed = fit_similarity(usual, true, with_scale=False).apply(np.broadcast_to(usual, true.shape))
    return figures_of(torch.from_numpy(placed), truth)
