"""Flexion angles, read from the keypoints alone, so that any two hand models can be compared."""

import numpy as np
from jaxtyping import Float

FINGER_CHAINS = np.array([[0, *range(first, first + 4)] for first in (1, 5, 9, 13, 17)])
"""Keypoints from the wrist to the tip of thumb, index, middle, ring and little finger."""


def flexion_deg(keypoints: Float[np.ndarray, "*batch 21 d"]) -> Float[np.ndarray, "*batch 5 3"]:
    """Angle between successive bones of each chain wrist-MCP-PIP-DIP-tip (thumb: wrist-CMC-MCP-IP-tip), degrees.

    Unsigned, 0 for a straight joint, up to 180. A bone of length zero has no direction: NaN.
    """
    chains = keypoints[..., FINGER_CHAINS, :]
    bones = np.diff(chains, axis=-2)
    length = np.linalg.norm(bones, axis=-1, keepdims=True)
    directions = bones / np.where(length > 0, length, np.nan)
    before, after = directions[..., :-1, :], directions[..., 1:, :]
    # 2·atan2(|a − b|, |a + b|) keeps its digits near 0 and 180, where arccos(a·b) loses half of them.
    apart = np.linalg.norm(before - after, axis=-1)
    together = np.linalg.norm(before + after, axis=-1)
    return np.degrees(2.0 * np.arctan2(apart, together))


def without_offset(errors: Float[np.ndarray, "frames *angles"]) -> Float[np.ndarray, "frames *angles"]:
    """Remove each angle's mean over the frames where it is known: two skeletons call different angles straight.

    An angle known in fewer than two frames has no offset to tell from its error: NaN.
    """
    is_known = np.isfinite(errors)
    count = is_known.sum(axis=0)
    offset = np.where(is_known, errors, 0.0).sum(axis=0) / np.maximum(count, 1)
    return np.where(count >= 2, errors - offset, np.nan)
