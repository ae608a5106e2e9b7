"""Flexion angles, read from the keypoints alone, so that any two hand models can be compared."""

import numpy as np
from jaxtyping import Float

from torchhand.hand import FINGER_CHAINS, FINGERS, KNUCKLES

FLEXIONS_OF_FINGERS = [[f"{finger}_{joint}_fe" for joint in ("mcp", "pip", "dip")] for finger in FINGERS[1:]]
"""The DOFs that bend the same joints of index, middle, ring and little finger."""


def flexion_deg(keypoints: Float[np.ndarray, "*batch 21 d"]) -> Float[np.ndarray, "*batch 5 3"]:
    """Angle between successive bones of each chain wrist-MCP-PIP-DIP-tip (thumb: wrist-CMC-MCP-IP-tip), degrees.

    Unsigned, 0 for a straight joint, up to 180. A bone of length zero has no direction: NaN.
    """
    chains = keypoints[..., np.array(FINGER_CHAINS), :]
    bones = np.diff(chains, axis=-2)
    length = np.linalg.norm(bones, axis=-1, keepdims=True)
    directions = bones / np.where(length > 0, length, np.nan)
    before, after = directions[..., :-1, :], directions[..., 1:, :]
    # 2·atan2(|a − b|, |a + b|) keeps its digits near 0 and 180, where arccos(a·b) loses half of them.
    difference = np.linalg.norm(before - after, axis=-1)
    together = np.linalg.norm(before + after, axis=-1)
    return np.degrees(2.0 * np.arctan2(difference, together))


PROXIMAL = np.array([(knuckle, knuckle + 1) for knuckle in KNUCKLES])
"""Keypoints at the ends of the five proximal phalanges."""


def proximal_turns_deg(keypoints_px: Float[np.ndarray, "frames 21 2"], reference: int) -> Float[np.ndarray, "frames 5"]:
    """How far each proximal phalanx has turned in the picture since a reference frame, degrees in (-180, 180]."""
    ends = keypoints_px[:, PROXIMAL]
    bone = ends[:, :, 1] - ends[:, :, 0]
    turned = np.degrees(np.arctan2(bone[..., 1], bone[..., 0]))
    return wrapped_deg(turned - turned[reference])


def wrapped_deg(angle: Float[np.ndarray, "*sizes"]) -> Float[np.ndarray, "*sizes"]:
    """The same direction in (-180, 180]."""
    return 180.0 - np.mod(180.0 - angle, 360.0)


def without_offset(errors: Float[np.ndarray, "frames *angles"]) -> Float[np.ndarray, "frames *angles"]:
    """Remove each angle's mean over the frames where it is known: two skeletons call different angles straight.

    An angle known in fewer than two frames has no offset to tell from its error: NaN.
    """
    is_known = np.isfinite(errors)
    count = is_known.sum(axis=0)
    offset = np.where(is_known, errors, 0.0).sum(axis=0) / np.maximum(count, 1)
    return np.where(count >= 2, errors - offset, np.nan)


def proximal_turns_in_space_deg(
    keypoints: Float[np.ndarray, "frames 21 3"], reference: int
) -> Float[np.ndarray, "frames 5"]:
    """How far each proximal phalanx has turned in space since a reference frame, degrees in [0, 180].

    Two hands that call different angles straight, and other axes theirs, agree on it.
    """
    ends = keypoints[:, PROXIMAL]
    bones = ends[:, :, 1] - ends[:, :, 0]
    length = np.linalg.norm(bones, axis=-1, keepdims=True)
    units = bones / np.where(length > 0, length, np.nan)
    across = np.linalg.norm(np.cross(units, units[reference]), axis=-1)
    return np.degrees(np.arctan2(across, (units * units[reference]).sum(-1)))
