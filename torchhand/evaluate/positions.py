"""Errors of joint positions: as they are, relative to the wrist, and after the best similarity."""

import numpy as np
from jaxtyping import Float

from torchhand.evaluate.alignment import fit_similarity
from torchhand.hand import TIPS

WRIST, MIDDLE_MCP = 0, 9


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
    """Distances of the fingertips, thumb to little, after each estimate was moved rigidly onto its truth: what is wrong
    with the fingers, wherever the hand is and however it is turned. All keypoints are laid over one another, for two
    hand models place the joints of the palm some millimetres apart, which would turn a hand that is held by these
    alone. NaN where a keypoint is."""
    moved = fit_similarity(estimate, truth, with_scale=False).apply(estimate)
    return joint_errors(moved, truth)[..., list(TIPS)]


def fingertip_distances(
    estimate: Float[np.ndarray, "*batch 21 3"], truth: Float[np.ndarray, "*batch 21 3"], *, is_one_camera: bool
) -> Float[np.ndarray, "*batch 5"]:
    """Distances of the fingertips from where they are: for one camera, in whose frame they are, across the line of
    sight at the depth of the truth; for several in space."""
    tips = list(TIPS)
    own, real = estimate[..., tips, :], truth[..., tips, :]
    if not is_one_camera:
        return joint_errors(own, real)
    across = own[..., :2] / own[..., 2:] - real[..., :2] / real[..., 2:]
    return np.linalg.norm(across * real[..., 2:], axis=-1)
