"""Recorded human motion as a motion script: joint angles of a sensing glove."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.errors import InputError
from torchhand.geometry import Camera
from torchhand.hand import JOINT_DOFS, HandKinematics
from torchhand.simulate.motion.motion import Motion, Staging, hand_length, perform, stage_before
from torchhand.simulate.motion.scripts import Course, planar_course

TIME_COLUMNS = 7
"""Year, month, day, hour, minute, second, flag."""
GLOVE_COLUMNS = (
    *("T-TMC", "T-MCP", "T-IP", "T-AA"),
    *(f"{finger}-{joint}" for finger in "IMRL" for joint in ("MCP", "PIP", "DIP", "AA")),
    *("arch", "wrist-FE", "wrist-AA"),
)
"""The 23 angles after the time; radians, flexion negative, the fingers' AA positive towards the thumb's side."""

_DAY_S = 86400.0

# dof: (column, factor, offset in degrees). The glove's thumb sensor turns about another axis and reads some 45 degrees
# where the thumb rests; the arch of the palm is shared out to the two metacarpals that move.
_SOURCES: dict[str, tuple[str, float, float]] = {
    "thumb_cmc_fe": ("T-TMC", -1.0, -45.0),
    "thumb_cmc_aa": ("T-AA", -1.0, 0.0),
    "thumb_mcp_fe": ("T-MCP", -1.0, 0.0),
    "thumb_ip_fe": ("T-IP", -1.0, 0.0),
    "ring_cmc_fe": ("arch", -0.25, 0.0),
    "little_cmc_fe": ("arch", -0.4, 0.0),
} | {
    f"{finger}_{joint}_fe": (f"{finger[0].upper()}-{joint.upper()}", -1.0, 0.0)
    for finger in ("index", "middle", "ring", "little")
    for joint in ("mcp", "pip", "dip")
}
# Our abductions lead away from the middle finger, the middle finger's own towards the thumb's side.
_SOURCES |= {f"{finger}_mcp_aa": (f"{finger[0].upper()}-AA", 1.0, 0.0) for finger in ("index", "middle")}
_SOURCES |= {f"{finger}_mcp_aa": (f"{finger[0].upper()}-AA", -1.0, 0.0) for finger in ("ring", "little")}


@dataclass(frozen=True, kw_only=True)
class GloveRecording:
    """Joint angles as they were recorded."""

    seconds: Float[np.ndarray, "rows"]
    """Times from the first row on, increasing."""
    angles: Float[np.ndarray, "rows 23"]
    """Angles in the order of GLOVE_COLUMNS, radians."""


def read_glove(path: str | Path) -> GloveRecording:
    """A text file of rows of 7 time columns and 23 angles, separated by blanks.

    Raises InputError naming the file and the row: missing, not a number, too few columns, time that runs backwards, or
    fewer than two samples.
    """
    path = Path(path)
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not a text file"
        raise InputError(f"{path}: cannot be read ({reason})") from error
    expected = TIME_COLUMNS + len(GLOVE_COLUMNS)
    rows = []
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        try:
            row = [float(word) for word in line.split()]
        except ValueError as error:
            raise InputError(f"{path}: row {number}: expected {expected} numbers, got {line[:40]!r}") from error
        if len(row) != expected or not all(map(math.isfinite, row)):
            raise InputError(f"{path}: row {number}: expected {expected} finite numbers, got {len(row)} numbers")
        rows.append(row)
    if len(rows) < 2:
        raise InputError(f"{path}: expected at least 2 rows of joint angles, got {len(rows)}")
    table = np.array(rows)
    clock = table[:, 3] * 3600 + table[:, 4] * 60 + table[:, 5]
    clock = clock + _DAY_S * np.cumsum(np.diff(clock, prepend=clock[0]) < -_DAY_S / 2)  # past midnight
    backwards = np.flatnonzero(np.diff(clock) < 0)
    if len(backwards):
        raise InputError(f"{path}: recorded row {backwards[0] + 2}: expected increasing times, got an earlier one")
    _, first = np.unique(clock, return_index=True)
    if len(first) < 2:
        raise InputError(f"{path}: expected increasing times, got one and the same in all rows")
    return GloveRecording(seconds=clock[first] - clock[0], angles=table[first, TIME_COLUMNS:])


def joints_of_glove(recording: GloveRecording, seconds: Float[np.ndarray, "frames"]) -> Float[Tensor, "frames 30"]:
    """Our joint angles at the given times, linear between the rows; float64, not yet within the limits."""
    joints = torch.zeros(len(seconds), len(JOINT_DOFS), dtype=torch.float64)
    for dof, (column, factor, offset_deg) in _SOURCES.items():
        angle = np.interp(seconds, recording.seconds, recording.angles[:, GLOVE_COLUMNS.index(column)])
        joints[:, JOINT_DOFS.index(dof)] = torch.from_numpy(factor * angle + math.radians(offset_deg))
    return joints


def recorded_motion(
    path: str | Path,
    frames: int,
    kinematics: HandKinematics,
    camera: Camera,
    generator: torch.Generator,
    *,
    shape: Float[Tensor, "shape"] | None = None,
    staging: Staging | None = None,
    start_s: float = 0.0,
) -> Motion:
    """Recorded joint angles, resampled to the frame rate and clamped to the skeleton's limits; float64.

    `start_s` is where in the recording the sequence starts, the pace how much faster it is played. The hand moves in
    the picture plane as well. The wrist's own angles are not used.

    Raises InputError as `read_glove` does, and where the recording is shorter than the frames wanted.
    """
    recording = read_glove(path)
    length, staging = hand_length(kinematics, shape), staging or Staging()
    stage = stage_before(camera, frames, generator, hand_length=length, staging=staging)
    times = start_s + staging.pace * stage.seconds.numpy()
    end = float(recording.seconds[-1])
    if start_s < 0 or times[-1] > end + 1e-9:
        raise InputError(
            f"{path}: expected a recording of at least {times[-1]:.2f} s (start {start_s:g} s, {frames} frames at"
            f" {staging.fps:g} frames/s, pace {staging.pace:g}), got {end:.2f} s"
        )
    joints = kinematics.skeleton.within_limits(joints_of_glove(recording, times))
    centre, turn = planar_course(stage, 0.6)
    course = Course(posture="flat", centre=centre, turn=turn)
    return perform(Path(path).stem, course, joints, camera, hand_length=length, stage=stage, staging=staging)
