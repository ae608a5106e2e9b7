"""The hand as teleoperation takes it: 21 points in the wrist's frame, and where the wrist is.

Axes of the wrist's frame: mano, those of MANO (fingers along -x of a right hand and +x of a left one, back of the hand
to y, the thumb's side to z); wrist, our hand frame and the base link of our URDF (x out of the back of the hand, y to
the fingers); operator, what retargeting libraries call the robot's frame (x out of the palm, z to the fingers). The
function serves live tracking frame by frame, the file holds the same messages, one line of JSON per frame.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.export.clip import MotionClip
from torchhand.files.disk import write_text
from torchhand.geometry import continuous, ordered_product, quaternion_of_rotation, rotation_from_vector
from torchhand.hand import Side
from torchhand.hand.conventions import mano_from_hand

WristAxes = Literal["mano", "wrist", "operator"]
TELEOPERATION_FORMAT = "torchhand teleoperation 1"
_OPERATOR_FROM_HAND = ((-1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0))


@dataclass(frozen=True, kw_only=True)
class WristPoints:
    """A hand in its wrist's frame."""

    points: Float[Tensor, "*batch 21 3"]
    """Keypoints in the wrist's frame, metres; the wrist is at the origin."""
    position: Float[Tensor, "*batch 3"]
    """Wrist in the world, metres: in the camera's frame where the pose is."""
    rotation: Float[Tensor, "*batch 3 3"]
    """world_from_wrist"""


def wrist_points(
    pose: Float[Tensor, "*batch 36"],
    keypoints: Float[Tensor, "*batch 21 3"],
    *,
    side: Side,
    axes: WristAxes = "mano",
) -> WristPoints:
    """The points of a pose in its wrist's frame, of one hand or many; NaN stays NaN.

    pose: of the tracker's estimate; its rotation vector is the whole rotation. keypoints: of the same estimate.
    """
    rotation = rotation_from_vector(pose[..., 3:6]) @ _axes_from_hand(axes, side).to(pose).mT
    wrist = keypoints[..., :1, :]
    points = ordered_product(keypoints - wrist, rotation)  # hand by hand, as in a stream, the bits of a file's batch
    return WristPoints(points=points, position=wrist.squeeze(-2), rotation=rotation)


def teleoperation_message(
    hand: WristPoints | None, *, side: Side, axes: WristAxes = "mano", frame: int, time_s: float, held: bool = False
) -> dict[str, Any]:
    """One frame as JSON knows it, for a stream or a file; a hand that is lost has points and wrist of None.

    hand: without batch dimensions. The wrist's quaternion is x, y, z, w.
    """
    content: dict[str, Any] = {"format": TELEOPERATION_FORMAT, "frame": frame, "time_s": time_s, "side": side}
    content |= {"axes": axes, "held": held, "points": None, "wrist": None}
    if hand is not None and bool(hand.points.isfinite().all()):
        quaternion = quaternion_of_rotation(hand.rotation)
        content["points"] = hand.points.tolist()
        content["wrist"] = {"position": hand.position.tolist(), "quaternion": quaternion.tolist()}
    return content


def write_teleoperation(clip: MotionClip, path: str | Path, *, axes: WristAxes = "mano") -> None:
    """Write a clip as lines of JSON, each a frame's message. The wrist stands in the track's frame, or with y or z up
    where the clip asks for that; where it asks for wrist or mano, these are the points' axes.
    """
    if clip.axes in ("wrist", "mano"):
        axes, placed = clip.axes, clip
    else:
        placed = clip.placed("camera")
    found = wrist_points(placed.poses, placed.frames.keypoints, side=clip.side, axes=axes)
    quaternions = continuous(quaternion_of_rotation(found.rotation)).tolist()  # no sign flips from frame to frame
    lines = []
    for t, (number, second, is_own) in enumerate(zip(clip.frame, clip.seconds.tolist(), clip.is_own, strict=True)):
        one = WristPoints(points=found.points[t], position=found.position[t], rotation=found.rotation[t])
        message = teleoperation_message(one, side=clip.side, axes=axes, frame=number, time_s=second, held=not is_own)
        message["wrist"]["quaternion"] = quaternions[t]
        lines.append(json.dumps(message, allow_nan=False))
    write_text(Path(path), "\n".join(lines) + "\n")


def _axes_from_hand(axes: WristAxes, side: Side) -> Tensor:
    """Axes of the wrist's frame from those of our hand frame, float64."""
    if axes == "mano":
        return mano_from_hand(side)
    rows = _OPERATOR_FROM_HAND if axes == "operator" else torch.eye(3).tolist()
    return torch.tensor(rows, dtype=torch.float64)
