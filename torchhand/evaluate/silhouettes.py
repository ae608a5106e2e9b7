"""Agreement of silhouettes, judged on the hand alone."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float

MaskOfFrame = Callable[[int], Bool[np.ndarray, "height width"] | None]
"""The hand's silhouette in the frame of a number; None where there is none."""


def intersection_over_union(
    first: Bool[np.ndarray, "*#batch height width"], second: Bool[np.ndarray, "*#batch height width"]
) -> Float[np.ndarray, "*batch"]:
    """Common area over total area, 0 to 1; NaN where both are empty, for there is nothing to compare."""
    common = np.sum(first & second, axis=(-2, -1), dtype=np.float64)
    total = np.sum(first | second, axis=(-2, -1), dtype=np.float64)
    return np.asarray(np.where(total > 0, common / np.maximum(total, 1.0), np.nan))


def cut_at_wrist(
    mask: Bool[np.ndarray, "height width"],
    wrist_px: Float[np.ndarray, "2"],
    middle_mcp_px: Float[np.ndarray, "2"],
) -> Bool[np.ndarray, "height width"]:
    """Drop the forearm: everything behind the line through the wrist, square to wrist-middle MCP.

    Where the two points are unknown (NaN) or coincide in the picture (the hand points at the camera), the mask is
    returned whole.
    """
    towards_fingers = middle_mcp_px - wrist_px
    if not np.isfinite(towards_fingers).all() or not towards_fingers.any():
        return mask
    height, width = mask.shape
    x, y = np.arange(width)[None, :], np.arange(height)[:, None]
    along = (x - wrist_px[0]) * towards_fingers[0] + (y - wrist_px[1]) * towards_fingers[1]
    return mask & (along >= 0.0)
