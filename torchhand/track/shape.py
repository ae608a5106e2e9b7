"""The proportions of a hand that one camera has followed through a recording (`torchhand.track.proportions`)."""

from collections.abc import Iterable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.hand import HandPose
from torchhand.numerics import single_threaded
from torchhand.track.knowledge import TrackerState, posture_features
from torchhand.track.proportions import SCHEDULE, FittedShape, contour_settings, fitted_shape
from torchhand.track.scene import View
from torchhand.track.tracker import Tracker

_TIME = 1.0  # radians that the recording's length is worth


@dataclass(frozen=True, kw_only=True)
class FollowedFrame:
    """A frame in which a hand was followed."""

    views: tuple[View, ...]
    time_s: float
    pose: Float[Tensor, "36"]
    """With the root's whole rotation vector, in the tracker's world."""


def spread_frames(poses: Float[Tensor, "frames 36"], is_good: Bool[Tensor, "frames"], count: int) -> list[int]:
    """Rows of at most `count` good frames that differ most in posture, direction and time, in their order.

    poses: with the root's whole rotation vector; rows that are not good may hold NaN. Chosen one by one, from the first
    good one on, each the farthest from all that are chosen (Gonzalez 1985).
    """
    rows = is_good.nonzero()[:, 0]
    if not len(rows) or count < 1:
        return []
    hands = HandPose.of(poses[rows]).normalized()
    time = _TIME * rows.to(poses) / max(1, len(poses) - 1)
    features = torch.cat((posture_features(hands), time[:, None]), 1)
    chosen, apart = [0], (features - features[0]).norm(dim=-1)
    while len(chosen) < min(count, len(rows)) and float(apart.max()) > 0:
        chosen.append(int(apart.argmax()))
        apart = torch.minimum(apart, (features - features[chosen[-1]]).norm(dim=-1))
    return rows[sorted(chosen)].tolist()


def frames_for_shape(poses: Float[Tensor, "frames 36"], overlap: Float[Tensor, "frames"], count: int) -> list[int]:
    """`spread_frames` of those in which a hand is followed at least as well as in half of them. overlap: with the
    silhouettes, NaN where it is not followed."""
    return spread_frames(poses, overlap >= overlap.nanquantile(0.5), count)


def can_tell_shape(tracker: Tracker) -> bool:
    """Whether a tracker's frames tell the proportions: they are not given, and the fingers flex before one camera."""
    return tracker.known_shape is None and len(tracker.parts.cameras) == 1 and tracker.parts.flexes


@torch.inference_mode()
@single_threaded()
def recorded_shape(tracker: Tracker, state: TrackerState, frames: Iterable[FollowedFrame]) -> FittedShape | None:
    """Proportions that explain well-spread frames, their poses free; None where too few of these show a hand.

    state: of the tracker, with the proportions before and the hand's colours.
    """
    assert state.shape is not None
    tracker = tracker.at(state)
    factor = tracker.parts.rule.overconfidence
    contours = contour_settings(tracker.settings.update, factor)
    fit = tracker.parts.frame_fit(state.shape, SCHEDULE, contours)
    poses_and_scenes = (
        (HandPose.of(one.pose.to(tracker.device)).normalized(), tracker.scene(state, one.views, one.time_s))
        for one in frames
    )
    seen = [fit.seen(scene, pose) for pose, scene in poses_and_scenes]
    return fitted_shape(fit, [one for one in seen if one is not None], factor)
