"""What a stream tells of one frame, as docs/live.md explains it: values that JSON knows, and an OSC bundle of them."""

import math
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np

from torchhand.files import FrameRecord
from torchhand.hand import DOFS, JOINT_DOFS

STREAM_FORMAT = "torchhand stream 1"
_ROOT = len(DOFS) - len(JOINT_DOFS)
_BUNDLE = b"#bundle\0" + struct.pack(">Q", 1)  # to be taken at once
_DIGITS = 6


def message_of(record: FrameRecord, *, side: str) -> dict[str, Any]:
    """One frame; None for what is not known, such as all numbers of a frame without a hand."""
    has_hand = bool(np.isfinite(record.pose).all())
    joints = dict(zip(JOINT_DOFS, _listed(record.pose[_ROOT:]), strict=True)) if has_hand else None
    spread = dict(zip(JOINT_DOFS, _listed(record.pose_std[_ROOT:]), strict=True)) if has_hand else None
    wrist = {"position": _listed(record.pose[:3]), "rotation": _listed(record.pose[3:_ROOT])} if has_hand else None
    variance = np.einsum("kii->k", record.keypoints3d_cov) / 3
    return {
        "format": STREAM_FORMAT,
        "frame": record.frame,
        "time_s": record.time_s,
        "status": record.status,
        "side": side,
        "wrist": wrist,
        "angles": joints,
        "angles_std": spread,
        "keypoints": _listed(record.keypoints3d) if has_hand else None,
        "keypoints_std": _listed(np.sqrt(variance)) if has_hand else None,
        "keypoints_px": None if record.keypoints2d is None or not has_hand else _listed(record.keypoints2d),
        "quality": _known(record.measures.get("quality", math.nan)),
        "finger_quality": _listed(record.finger_quality) if has_hand and record.finger_quality is not None else None,
        "seconds": round(record.seconds, _DIGITS),
    }


def osc_bundle(message: dict[str, Any]) -> bytes:
    """The same as one OSC 1.0 bundle; numbers in the order of JSON's, nothing for what is not known."""
    frame, time_s = message["frame"], message["time_s"] or 0.0
    parts = [_osc("/torchhand/frame", [frame, float(time_s), message["status"], message["side"]])]
    if message["angles"] is not None:
        parts.append(_osc("/torchhand/wrist", [*message["wrist"]["position"], *message["wrist"]["rotation"]]))
        parts.append(_osc("/torchhand/angles", list(message["angles"].values())))
        parts.append(_osc("/torchhand/angles_std", list(message["angles_std"].values())))
        parts.append(_osc("/torchhand/keypoints", [x for point in message["keypoints"] for x in point]))
    if message["finger_quality"] is not None:
        parts.append(_osc("/torchhand/finger_quality", message["finger_quality"]))
    return _BUNDLE + b"".join(struct.pack(">i", len(part)) + part for part in parts)


def _osc(address: str, values: Sequence[int | float | str | None]) -> bytes:
    known = [math.nan if value is None else value for value in values]
    kinds = {int: "i", float: "f", str: "s"}
    tags = "," + "".join(kinds[type(value)] for value in known)
    content = b"".join(
        _osc_text(value) if isinstance(value, str) else struct.pack(">i" if isinstance(value, int) else ">f", value)
        for value in known
    )
    return _osc_text(address) + _osc_text(tags) + content


def _osc_text(text: str) -> bytes:
    """Ended by a zero and filled with more to a multiple of four bytes."""
    raw = text.encode()
    return raw + bytes(4 - len(raw) % 4)


def _listed(array: np.ndarray) -> Any:
    """Nested lists, to a micrometre and a microradian, with None for what is not finite."""
    if array.ndim == 1:
        return [_known(float(value)) for value in array]
    return [_listed(row) for row in array]


def _known(value: float) -> float | None:
    return round(value, _DIGITS) if math.isfinite(value) else None
