"""A tracker over the frames of one sequence: from pictures to the records that a result folder holds."""

import math
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import torch

from torchhand.files import Frame, FrameRecord
from torchhand.hand import DOFS
from torchhand.runs.trackers import AnyTracker
from torchhand.track import Estimate, Memory, TrackerState

MEASURES = ("overlap", "found", "nis")
"""Numbers of every frame that tell how far the estimate can be trusted, as `Estimate` explains them."""


@dataclass(frozen=True, kw_only=True)
class TrackedFrame:
    """One frame and what the tracker made of it."""

    frame: Frame
    record: FrameRecord
    state: TrackerState | None
    """After this frame."""
    memory: Memory
    """After this frame."""


def follow(
    tracker: AnyTracker,
    frames: Iterable[Frame],
    state: TrackerState | None = None,
    memory: Memory | None = None,
) -> Iterator[TrackedFrame]:
    """Track frame after frame; `state` and `memory` are those of the frame before, where an earlier run is continued.

    A frame without a picture is `no_hand`: time passes for the tracker, which sees nothing. `seconds` of a record is
    the tracker's time alone, without reading the picture.
    """
    memory = memory or Memory()
    for frame in frames:
        if frame.image is None:
            state, _ = tracker.skip(state)
            yield TrackedFrame(frame=frame, record=_unread(frame), state=state, memory=memory)
            continue
        started = time.perf_counter()
        with torch.inference_mode():
            state, memory, estimate = tracker.step(state, memory, frame.image)
        seconds = time.perf_counter() - started
        yield TrackedFrame(
            frame=frame, record=record_of(frame.index, estimate, seconds=seconds), state=state, memory=memory
        )


def record_of(index: int, estimate: Estimate, *, seconds: float) -> FrameRecord:
    """The record of one estimate; NaN where it holds nothing."""
    values = {name: getattr(estimate, name) for name in MEASURES}
    measures = {name: math.nan if value is None else float(value) for name, value in values.items()}
    arrays = {
        "pose": estimate.pose,
        "pose_std": estimate.pose_std,
        "keypoints3d": estimate.keypoints,
        "keypoints2d": estimate.keypoints_px,
        "keypoints3d_cov": estimate.keypoints_cov,
    }
    known = {name: array.double().cpu().numpy() for name, array in arrays.items() if array is not None}
    if len(known) < len(arrays):
        return FrameRecord.empty(
            index, estimate.status, dofs=len(DOFS), seconds=seconds, measures=measures, reason=estimate.reason
        )
    return FrameRecord(
        frame=index, status=estimate.status, seconds=seconds, measures=measures, reason=estimate.reason, **known
    )


def _unread(frame: Frame) -> FrameRecord:
    """The record of a frame that could not be decoded."""
    nothing: dict[str, float] = dict.fromkeys(MEASURES, math.nan)
    reason = frame.problem or "the frame cannot be decoded"
    return FrameRecord.empty(frame.index, "no_hand", dofs=len(DOFS), seconds=0.0, measures=nothing, reason=reason)
