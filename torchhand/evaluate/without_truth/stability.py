"""Whether two results of one recording (encoded anew, tracked with other settings) say the same within their spread."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from torchhand.errors import InputError
from torchhand.files import Track
from torchhand.hand import JOINT_DOFS

_MOST_STD = 3.0  # combined standard deviations, beyond which two angles contradict each other


@dataclass(frozen=True, kw_only=True)
class JointStability:
    """How one joint angle, or all of them, differ between two results."""

    fraction_apart: float
    """Share of the angles that differ by more than three of their combined standard deviations."""
    median_deg: float
    """Median of the differences' magnitudes, degrees."""
    percentile95_deg: float

    @classmethod
    def of(cls, missed: Float[np.ndarray, "..."], std: Float[np.ndarray, "..."]) -> "JointStability":
        """missed: differences, radians. std: combined standard deviations."""
        size = np.rad2deg(np.abs(missed))
        return cls(
            fraction_apart=float(np.mean(np.abs(missed) > _MOST_STD * std)),
            median_deg=float(np.median(size)),
            percentile95_deg=float(np.percentile(size, 95)),
        )


@dataclass(frozen=True, kw_only=True)
class Stability:
    """How two results of one recording differ, over the frames in which both have a hand."""

    frames: int
    """Frames that were compared."""
    frames_in_one: int
    """Frames in which one result alone has a hand."""
    whole: JointStability
    """All joint angles together."""
    joints: Mapping[str, JointStability]
    """By the DOF's name."""


def stability(one: Track, other: Track) -> Stability:
    """Compare the joint angles that were free in both, frame by frame.

    Raises InputError for tracks of other DOFs than this version's hand, and where no frame has a hand in both.
    """
    for track in (one, other):
        if any(name not in track.dof_names for name in JOINT_DOFS):
            raise InputError(
                f"dof_names: expected the {len(JOINT_DOFS)} joint angles of this version's hand, got others"
            )
    _, here, there = np.intersect1d(one.frame, other.frame, return_indices=True)
    is_known = one.has_hand[here] & other.has_hand[there]
    if not is_known.any():
        raise InputError(f"expected frames with a hand in both results, got none in {len(here)} common frames")
    pairs = [(track, rows[is_known]) for track, rows in ((one, here), (other, there))]
    columns = [[track.dof_names.index(name) for name in JOINT_DOFS] for track, _ in pairs]
    pose, std = (
        [getattr(track, name)[rows][:, own] for (track, rows), own in zip(pairs, columns, strict=True)]
        for name in ("pose", "pose_std")
    )
    is_free = np.any(std[0] > 0, axis=0) & np.any(std[1] > 0, axis=0)
    if not is_free.any():
        raise InputError("expected joint angles that were free in both results, got none: all are held")
    missed, spread = (pose[0] - pose[1])[:, is_free], np.hypot(*std)[:, is_free]
    names = [name for name, free in zip(JOINT_DOFS, is_free, strict=True) if free]
    return Stability(
        frames=int(is_known.sum()),
        frames_in_one=int((one.has_hand[here] ^ other.has_hand[there]).sum()),
        whole=JointStability.of(missed, spread),
        joints={name: JointStability.of(missed[:, i], spread[:, i]) for i, name in enumerate(names)},
    )
