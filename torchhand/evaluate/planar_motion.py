"""How well a motion in the picture plane was followed, whatever joint centres the two models use."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from torchhand.evaluate.alignment import fit_similarity
from torchhand.evaluate.finite import is_finite_set


@dataclass(frozen=True, kw_only=True)
class PlanarMotionErrors:
    """Error of the motion since the reference frame, per frame; NaN where the hand or its truth is unknown.

    The reference frame itself, right by definition, is NaN too, so that it improves no mean.
    """

    reference: int
    """Row of the frame that motions are measured from: the first that estimate and truth both know."""
    rotation_deg: Float[np.ndarray, "frames"]
    """Estimated minus true rotation in the plane, wrapped to ±180, positive from x to y (clockwise on screen)."""
    displacement_px: Float[np.ndarray, "frames"]
    """Distance between the images of one point, the centroid of the true keypoints in the reference frame."""
    displacement_with_scale_px: Float[np.ndarray, "frames"]
    """Displacement error where both motions may also scale, for a hand that moves in depth."""
    scale_percent: Float[np.ndarray, "frames"]
    """Estimated scale over true scale, minus one, in percent."""
    true_scale: Float[np.ndarray, "frames"]
    """Scale of the truth against the reference frame; far from 1 where the hand moves in depth."""


def planar_motion_errors(
    estimate_px: Float[np.ndarray, "frames n 2"], truth_px: Float[np.ndarray, "frames n 2"]
) -> PlanarMotionErrors | None:
    """Compare the motions from the reference frame to every frame, each fitted to its own keypoints.

    The least-squares rigid motion of the estimate's keypoints is compared with that of the truth's, so a constant
    offset between the two models' joint centres cancels. None if no frame is known to both.
    """
    is_known = is_finite_set(estimate_px) & is_finite_set(truth_px)
    if not is_known.any():
        return None
    reference = int(np.argmax(is_known))
    centroid = truth_px[reference].mean(axis=0, keepdims=True)

    displacement = {}
    scale = {}
    turn = {}
    for with_scale in (False, True):
        estimated = fit_similarity(estimate_px[reference], estimate_px, with_scale=with_scale)
        true = fit_similarity(truth_px[reference], truth_px, with_scale=with_scale)
        difference = estimated.apply(centroid) - true.apply(centroid)
        displacement[with_scale] = _without(np.linalg.norm(difference[..., 0, :], axis=-1), reference)
        scale[with_scale] = estimated.scale / true.scale
        turn[with_scale] = np.swapaxes(true.rotation, -1, -2) @ estimated.rotation
    true_scale = fit_similarity(truth_px[reference], truth_px, with_scale=True).scale
    angle = np.arctan2(turn[False][..., 1, 0], turn[False][..., 0, 0])
    return PlanarMotionErrors(
        reference=reference,
        rotation_deg=_without(np.degrees(angle), reference),
        displacement_px=displacement[False],
        displacement_with_scale_px=displacement[True],
        scale_percent=_without(100.0 * (scale[True] - 1.0), reference),
        true_scale=true_scale,
    )


def _without(values: Float[np.ndarray, "frames"], reference: int) -> Float[np.ndarray, "frames"]:
    values = values.copy()
    values[reference] = np.nan
    return values
