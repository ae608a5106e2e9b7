"""The joint angles over time as a table that spreadsheets and `pandas.read_csv` take as it is.

A line per frame: frame, time_s (from the first frame on), status, then for each of the 30 joint
angles its value and its standard deviation, `NAME_deg` and `NAME_std_deg`, in degrees, and for each finger the
probability that its tip is right, `FINGER_quality`.
Frames without an estimate keep their line, with empty cells.
"""

import math
from pathlib import Path

import torch

from torchhand.export.clip.motion_clip import MotionClip
from torchhand.files.disk import write_text
from torchhand.hand import DOFS, FINGERS, JOINT_DOFS

ANGLE_SUFFIX = "angles.csv"
_FIRST = len(DOFS) - len(JOINT_DOFS)
_COLUMNS = ("deg", "std_deg")


def write_angles(clip: MotionClip, path: str | Path) -> None:
    """Write the file. Standard deviations and qualities are empty where the clip knows none."""
    angles = torch.rad2deg(clip.poses[:, _FIRST:]).tolist()
    spread = torch.full_like(clip.poses, math.nan) if clip.pose_std is None else clip.pose_std
    std, held = torch.rad2deg(spread[:, _FIRST:]).tolist(), set(clip.held)
    unknown = torch.full((len(clip), len(FINGERS)), math.nan)
    quality = (unknown if clip.finger_quality is None else clip.finger_quality).tolist()
    columns = [f"{name}_{kind}" for name in JOINT_DOFS for kind in _COLUMNS]
    columns += [f"{finger}_quality" for finger in FINGERS]
    lines = [",".join(("frame", "time_s", "status", *columns))]
    seconds = clip.seconds.tolist()
    for t, number in enumerate(clip.frame):
        status = clip.status[t] if clip.status else ("lost" if number in held else "tracked")
        pairs = zip(angles[t], std[t], strict=True)
        cells = [_cell(value, empty=number in held) for pair in pairs for value in pair]
        cells += [_cell(value, empty=number in held) for value in quality[t]]
        lines.append(",".join((str(number), repr(seconds[t]), status, *cells)))
    write_text(Path(path), "\n".join(lines) + "\n")


def _cell(value: float, *, empty: bool) -> str:
    return "" if empty or not math.isfinite(value) else f"{value:.4f}"
