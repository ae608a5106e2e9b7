"""Errors of joint positions: as they are, relative to the wrist, and after the best similarity."""

import numpy as np
from jaxtyping import Float

from torchhand.evaluate.alignment import fit_similarity
from torchhand.hand import KEYPOINTS

WRIST = 0
PALM = [i for i, name in enumerate(KEYPOINTS) if name == "wrist" or (name.endswith("_mcp") and "thumb" not in name)]
"""Keypoints that no finger moves: the wrist and the knuckles of the four fingers."""
TIPS = [i for i, name in enumerate(KEYPOINTS) if name.endswith("_tip")]


def joint_errors(
    estimate: Float[np.ndarray, "*batch joints d"], truth: Float[np.ndarray, "*batch joints d"]
) -> Float[np.ndarray, "*batch joints"]:
    """Distance of each estimated joint from its truth, in the points' unit (metres in space, px in the picture)."""
    return np.linalg.norm(estimate - truth, axis=-1)


def root_relative_errors(
    estimate: Float[np.ndarray, "*batch joints 3"], truth: Float[np.ndarray, "*batch joints 3"]
) -> Float[np.ndarray, "*batch joints"]:
    """Distances after both hands were moved to a common wrist (keypoint 0, whose own error is then 0)."""
    wrist = slice(WRIST, WRIST + 1)
    return joint_errors(estimate - estimate[..., wrist, :], truth - truth[..., wrist, :])


def aligned_errors(
    estimate: Float[np.ndarray, "*batch joints 3"], truth: Float[np.ndarray, "*batch joints 3"]
) -> Float[np.ndarray, "*batch joints"]:
    """Distances after each estimate was moved onto its truth by the best similarity (Procrustes-aligned, "PA").

    A mirrored hand stays wrong: no reflection is allowed. A set with a NaN gives NaN for all its joints.
    """
    return joint_errors(fit_similarity(estimate, truth, with_scale=True).apply(estimate), truth)


def fingertip_errors(
    estimate: Float[np.ndarray, "*batch 21 3"], truth: Float[np.ndarray, "*batch 21 3"]
) -> Float[np.ndarray, "*batch 5"]:
    """Distances of the fingertips, thumb to little, after each estimate was moved rigidly onto its truth by the palm:
    what is wrong with the fingers, wherever the hand is. NaN where a keypoint of the palm or the tip is."""
    moved = fit_similarity(estimate[..., PALM, :], truth[..., PALM, :], with_scale=False).apply(estimate[..., TIPS, :])
    return joint_errors(moved, truth[..., TIPS, :])
