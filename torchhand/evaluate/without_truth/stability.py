"""Whether two results of one recording (encoded anew, tracked with other settings) say the same within their spread."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from torchhand.errors import InputError
from torchhand.files import Track
from torchhand.hand import JOINT_DOFS

_MOST_STD = 3.0  # combined standard deviations, beyond which two angles contradict each other
_BAND_STD = 1.96  # half of the 95 % band of a normal distribution
LARGE_STEP_DEG = 15.0
"""From one frame to the next: few joints move so far in a thirtieth of a second."""


@dataclass(frozen=True, kw_only=True)
class JointStability:
    """How one joint angle, or all of them, differ between two results."""

    fraction_apart: float
    """Share of the angles that differ by more than three of their combined standard deviations."""
    median_deg: float
    """Median of the differences' magnitudes, degrees."""
    percentile95_deg: float
    rms_deg: float
    """Root mean square of the differences, degrees."""
    fraction_in_own_band: float
    """Share of the first result's angles whose own 95 % band holds the second's. About the result of more cameras, of
    which the first has some, an honest result has 0.95."""
    largest_step_deg: float
    """Largest change of the first result's angle from one frame to the next, degrees; NaN without two in a row."""
    large_steps: int
    """Such changes over 15 degrees."""

    @classmethod
    def of(
        cls,
        missed: Float[np.ndarray, "frames angles"],
        std: Float[np.ndarray, "frames angles"],
        own_std: Float[np.ndarray, "frames angles"],
        steps: Float[np.ndarray, "steps angles"],
    ) -> "JointStability":
        """missed: differences, radians. std: combined standard deviations; own_std: of the first result. steps: its
        changes from frame to frame."""
        size = np.rad2deg(np.abs(missed))
        return cls(
            fraction_apart=float(np.mean(np.abs(missed) > _MOST_STD * std)),
            median_deg=float(np.median(size)),
            percentile95_deg=float(np.percentile(size, 95)),
            rms_deg=float(np.sqrt(np.mean(np.square(size)))),
            fraction_in_own_band=float(np.mean(np.abs(missed) <= _BAND_STD * own_std)),
            largest_step_deg=float(np.rad2deg(np.abs(steps).max())) if steps.size else float("nan"),
            large_steps=int((np.rad2deg(np.abs(steps)) > LARGE_STEP_DEG).sum()),
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
    missed, spread, own = (pose[0] - pose[1])[:, is_free], np.hypot(*std)[:, is_free], std[0][:, is_free]
    steps = np.diff(one.pose, axis=0)[(np.diff(one.frame) == 1) & one.has_hand[1:] & one.has_hand[:-1]]
    steps = steps[:, columns[0]][:, is_free]
    names = [name for name, free in zip(JOINT_DOFS, is_free, strict=True) if free]
    return Stability(
        frames=int(is_known.sum()),
        frames_in_one=int((one.has_hand[here] ^ other.has_hand[there]).sum()),
        whole=JointStability.of(missed, spread, own, steps),
        joints={
            name: JointStability.of(missed[:, [i]], spread[:, [i]], own[:, [i]], steps[:, [i]])
            for i, name in enumerate(names)
        },
    )
