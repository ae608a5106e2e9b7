"""From a tracker's estimates to the records that a result folder holds."""

import math
from collections.abc import Sequence

import numpy as np

from torchhand.files import FrameRecord
from torchhand.files.results import DETERMINED
from torchhand.hand import DOFS, FINGERS
from torchhand.track import Estimate

MEASURES = ("quality", "overlap", "edges", "inside", "unexplained", "nis", "score")
"""Numbers of every frame that tell how far the estimate can be trusted, as `Estimate` explains them."""


def record_of(
    index: int, estimate: Estimate, camera_names: Sequence[str], *, seconds: float, problems: str = ""
) -> FrameRecord:
    """The record of one estimate; NaN where it holds nothing. problems: of views that could not be read."""
    is_rig = len(camera_names) > 1
    measures = {name: _number(getattr(estimate, name)) for name in MEASURES}
    if is_rig:
        overlaps = [math.nan] * len(camera_names) if estimate.overlaps is None else estimate.overlaps.tolist()
        measures["views"] = float(estimate.views)
        measures |= {f"overlap_{name}": overlap for name, overlap in zip(camera_names, overlaps, strict=True)}
    arrays = {
        "pose": estimate.pose,
        "pose_std": estimate.pose_std,
        "keypoints3d": estimate.keypoints,
        "keypoints3d_cov": estimate.keypoints_cov,
        "finger_quality": estimate.finger_quality,
    }
    known = {name: array.double().cpu().numpy() for name, array in arrays.items() if array is not None}
    if len(known) < len(arrays):
        reason = "; ".join(text for text in (estimate.reason, problems) if text)
        return FrameRecord.empty(
            index,
            estimate.status,
            dofs=len(DOFS),
            seconds=seconds,
            has_keypoints2d=not is_rig,
            time_s=estimate.time_s,
            measures=measures | {"quality": math.nan, "score": math.nan},
            reason=reason,
        )
    pixels = None
    if not is_rig and estimate.keypoints_px is not None:
        pixels = estimate.keypoints_px[0].double().cpu().numpy()
    return FrameRecord(
        frame=index,
        time_s=estimate.time_s,
        status=estimate.status,
        keypoints2d=pixels,
        seconds=seconds,
        measures=measures,
        reason="",
        **known,
    )


def undetermined_fingers(finger_quality: np.ndarray | None) -> list[str]:
    """Names of the fingers whose quality says that they are not determined; none where it says nothing."""
    if finger_quality is None:
        return []
    return [name for name, quality in zip(FINGERS, finger_quality, strict=True) if quality < DETERMINED]


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)
