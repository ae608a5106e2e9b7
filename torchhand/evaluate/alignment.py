"""The rigid motion or similarity between two point sets of known correspondence, in the plane or in space."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from torchhand.evaluate.finite import is_finite_set


@dataclass(frozen=True, kw_only=True)
class Similarity:
    """target = scale · rotation · source + translation."""

    rotation: Float[np.ndarray, "*batch d d"]
    """Proper rotation: determinant 1, never a mirror."""
    scale: Float[np.ndarray, "*batch"]
    """1 where a rigid motion was asked for."""
    translation: Float[np.ndarray, "*batch d"]
    """Translation in the points' unit."""

    def apply(self, points: Float[np.ndarray, "*#batch n d"]) -> Float[np.ndarray, "*batch n d"]:
        """Move points."""
        moved = points @ np.swapaxes(self.rotation, -1, -2)
        return self.scale[..., None, None] * moved + self.translation[..., None, :]


def fit_similarity(
    source: Float[np.ndarray, "*#batch n d"], target: Float[np.ndarray, "*#batch n d"], *, with_scale: bool
) -> Similarity:
    """Least-squares motion of `source` onto `target` (Umeyama 1991, equations 40-42; without scale: Kabsch).

    Where either set has a NaN, or a scale is asked for and all source points coincide, the result is NaN.
    """
    source, target = np.broadcast_arrays(source, target)
    is_known = is_finite_set(source) & is_finite_set(target)
    source_known = np.where(is_known[..., None, None], source, 0.0)
    target_known = np.where(is_known[..., None, None], target, 0.0)
    source_centre = source_known.mean(axis=-2)
    target_centre = target_known.mean(axis=-2)
    source_arms = source_known - source_centre[..., None, :]
    target_arms = target_known - target_centre[..., None, :]

    left, singular, right = np.linalg.svd(np.swapaxes(target_arms, -1, -2) @ source_arms)
    signs = np.ones_like(singular)
    signs[..., -1] = np.where(np.linalg.det(left) * np.linalg.det(right) < 0, -1.0, 1.0)
    rotation = (left * signs[..., None, :]) @ right

    scale = np.ones(is_known.shape)
    if with_scale:
        spread = np.sum(source_arms**2, axis=(-2, -1))
        has_spread = spread > 0
        scale = np.where(has_spread, np.sum(singular * signs, axis=-1) / np.where(has_spread, spread, 1.0), np.nan)
    scale = np.where(is_known, scale, np.nan)
    rotation = np.where(is_known[..., None, None], rotation, np.nan)
    moved_centre = scale[..., None] * (rotation @ source_centre[..., None])[..., 0]
    return Similarity(rotation=rotation, scale=scale, translation=target_centre - moved_centre)
