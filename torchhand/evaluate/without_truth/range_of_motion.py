"""What a recording tells by itself, without a truth: how far every joint moved, and how well that is known."""

import math
from dataclasses import dataclass

import numpy as np

from torchhand.errors import InputError
from torchhand.files import Track
from torchhand.hand import FINGERS, JOINT_DOFS

_DEG = 180 / math.pi
_TOTAL = "total_flexion"
_FLEXED = {finger: ("mcp_fe", "ip_fe") if finger == "thumb" else ("mcp_fe", "pip_fe", "dip_fe") for finger in FINGERS}


@dataclass(frozen=True, kw_only=True)
class JointRange:
    """Smallest and largest value of one joint angle over the tracked frames, degrees."""

    smallest_deg: float
    smallest_std_deg: float
    """Standard deviation of the angle in the frame of the smallest value."""
    smallest_frame: int
    largest_deg: float
    largest_std_deg: float
    largest_frame: int

    @property
    def range_deg(self) -> float:
        """Largest less smallest."""
        return self.largest_deg - self.smallest_deg


def range_of_motion(track: Track) -> dict[str, JointRange]:
    """Range of every joint angle that was free, by its DOF's name, and of the flexion summed over each digit's MCP, PIP
    and DIP (thumb: MCP and IP), `FINGER_total_flexion`, whose joints count as independent.

    Raises InputError for a track of other DOFs than this version's hand, or without a single estimate.
    """
    missing = [name for name in JOINT_DOFS if name not in track.dof_names]
    if missing:
        raise InputError(f"dof_names: expected the {len(JOINT_DOFS)} joint angles of this version's hand, got others")
    is_known = np.isfinite(track.pose).all(-1)
    if not is_known.any():
        raise InputError(f"expected at least one tracked frame, got none in {len(track)} frames: all are lost")
    frames, pose, std = track.frame[is_known], track.pose[is_known] * _DEG, track.pose_std[is_known] * _DEG
    place = {name: track.dof_names.index(name) for name in JOINT_DOFS}
    found = {
        name: _range(frames, pose[:, column], std[:, column])
        for name, column in place.items()
        if np.any(std[:, column] > 0)
    }
    for finger in FINGERS:
        columns = [place[f"{finger}_{joint}"] for joint in _FLEXED[finger]]
        if any(f"{finger}_{joint}" in found for joint in _FLEXED[finger]):
            spread = np.sqrt(np.square(std[:, columns]).sum(-1))
            found[f"{finger}_{_TOTAL}"] = _range(frames, pose[:, columns].sum(-1), spread)
    return found


def _range(frames: np.ndarray, values: np.ndarray, std: np.ndarray) -> JointRange:
    low, high = int(values.argmin()), int(values.argmax())
    return JointRange(
        smallest_deg=float(values[low]),
        smallest_std_deg=float(std[low]),
        smallest_frame=int(frames[low]),
        largest_deg=float(values[high]),
        largest_std_deg=float(std[high]),
        largest_frame=int(frames[high]),
    )
