"""What the tests of the tracker share: pictures taken frame after frame, and estimates compared with the truth."""

import io
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.hand import Hand
from torchhand.track import Estimate, Tracker, TrackerState, View, restored_state, saved_state

FRAME_S = 1 / 30
HAND_FIELDS = ("pose", "pose_std", "keypoints", "keypoints_px", "keypoints_cov")


def right_hand() -> Hand:
    return load_hand_model().hand(side="right", dtype=torch.float64)


def run(
    tracker: Tracker, images: Sequence[Tensor | None], state: TrackerState | None = None
) -> tuple[Any, list[Estimate]]:
    """The state after pictures of one camera, a frame each, and their estimates; None is a frame without a picture."""
    estimates: list[Estimate] = []
    for image in images:
        last = None if state is None else state.time_s
        time_s = 0.0 if last is None else last + FRAME_S
        state, estimate = tracker.step(state, (View(image=image),), time_s)
        estimates.append(estimate)
    return state, estimates


def saved_and_restored(state: TrackerState) -> TrackerState:
    file = io.BytesIO()
    torch.save(saved_state(state), file)
    file.seek(0)
    return restored_state(torch.load(file, weights_only=True))


def points_px(estimates: Sequence[Estimate]) -> Tensor:
    """(estimates, 21, 2), of the first camera."""
    return torch.stack([estimate.keypoints_px[0] for estimate in estimates if estimate.keypoints_px is not None])


def motion_error_px(estimates: Sequence[Estimate], truth: Tensor) -> Tensor:
    """Error of the keypoints' motion since the first frame, mean over the points: joint centres may differ a bit."""
    points = points_px(estimates)
    assert len(points) == len(truth)
    return ((points - points[0]) - (truth - truth[0])).norm(dim=-1).mean(-1)


def assert_equal(one: Estimate, other: Estimate) -> None:
    for field in fields(Estimate):
        a, b = getattr(one, field.name), getattr(other, field.name)
        assert torch.equal(a, b) if isinstance(a, Tensor) else a == b, field.name


def assert_complete(estimate: Estimate) -> None:
    for name in HAND_FIELDS:
        value = getattr(estimate, name)
        assert value is not None, name
        assert bool(value.isfinite().all()), name
    assert estimate.overlap is not None
    assert estimate.edges is not None
    assert estimate.reason == ""


def assert_empty(estimate: Estimate) -> None:
    for name in (*HAND_FIELDS, "overlaps", "overlap", "edges", "inside", "unexplained", "nis"):
        assert getattr(estimate, name) is None, name
    assert estimate.reason
