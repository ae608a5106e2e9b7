"""The evidence for fingers of tracked simulated hands, and how far their tips are off."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.devices import HOST
from torchhand.evaluate import fingertip_distances, fingertip_errors
from torchhand.files import load_hand_model
from torchhand.hand import DOFS
from torchhand.study import seed_of
from torchhand.study.quality.sequences import FPS, SimulatedSequence, sequence
from torchhand.track import (
    Estimate,
    FittedShape,
    FollowedFrame,
    FurtherPass,
    Tracker,
    TrackerSettings,
    TrackerState,
    can_tell_shape,
    frames_for_shape,
    recorded_shape,
)
from torchhand.track.single import SinglePoseFitter

FRAMES, RIG_FRAMES = 50, 25
"""Pictures that each camera takes of a sequence, one camera alone and several."""


@dataclass(frozen=True, kw_only=True)
class FingerSample:
    """One estimate of a tracked simulated hand."""

    evidence: Float[Tensor, "5 evidence"]
    error_m: Float[Tensor, "5"]
    """Distance of each fingertip from the truth, as `fingertip_errors` has it."""
    farthest_m: float
    """Distance of the worst fingertip; for one camera across the line of sight."""
    sequence: int
    """Number of the sequence."""


def collect(
    settings: TrackerSettings, count: int, seed: int, device: torch.device = HOST, *, frames: int = FRAMES
) -> Iterator[list[FingerSample]]:
    """The estimates of each of `count` recordings, every other one with the points of a detector, and every third one
    without what a network sees.

    The hand is found and followed as `torchhand track` does it: forwards, then back with the proportions that the
    frames tell; the estimates of both passes are samples. The same seed gives the same samples. device: of the tracker.
    frames: of each recording.
    """
    hand = load_hand_model().to(device=device).hand(side="right", dtype=torch.float64)
    silent = replace(settings, learned_posture=False)
    for index in range(count):
        generator = torch.Generator().manual_seed(seed_of(seed, "quality", index))
        own = sequence(generator, frames, has_detector=index % 2 == 1)
        tracker = Tracker(hand, own.cameras, silent if index % 3 == 2 else settings)
        yield _samples(own, tracker, index)


def collect_rigs(
    settings: Sequence[TrackerSettings], count: int, seed: int, device: torch.device = HOST, *, frames: int = RIG_FRAMES
) -> Iterator[list[FingerSample]]:
    """The same of hands before two, three and four cameras in turn, whatever a network sees. settings: which take
    turns, too."""
    hand = load_hand_model().to(device=device).hand(side="right", dtype=torch.float64)
    for index in range(count):
        generator = torch.Generator().manual_seed(seed_of(seed, "rig quality", index))
        own = sequence(generator, frames, has_detector=index % 2 == 1, cameras=2 + index % 3)
        tracker = Tracker(hand, own.cameras, settings[index // 3 % len(settings)])
        yield _samples(own, tracker, index)


def collect_single(fitter: SinglePoseFitter, count: int, seed: int) -> Iterator[list[FingerSample]]:
    """The same of single pictures: the first of each sequence, every other one with the points of a detector."""
    for index in range(count):
        generator = torch.Generator().manual_seed(seed_of(seed, "single quality", index))
        own = sequence(generator, 1, has_detector=index % 2 == 1)
        [first], [camera] = own.frames, own.cameras
        estimate = fitter(first.views[0], camera).estimate
        yield [] if estimate.evidence is None else [_sample(estimate, first.keypoints, index)]


def _samples(own: SimulatedSequence, tracker: Tracker, sequence: int) -> list[FingerSample]:
    is_one = len(own.cameras) == 1
    return [
        _sample(estimate, keypoints, sequence, is_one_camera=is_one)
        for estimate, keypoints in _tracked(own, tracker)
        if estimate.pose is not None
    ]


def _tracked(own: SimulatedSequence, tracker: Tracker) -> Iterator[tuple[Estimate, Float[Tensor, "21 3"]]]:
    """The estimates of both passes, with the true keypoints."""
    state, forward = None, list[Estimate]()
    for number, frame in enumerate(own.frames):
        state, estimate = tracker.step(state, frame.views, number / FPS)
        forward.append(estimate)
        yield estimate, frame.keypoints
    if state is None or state.shape is None:
        return
    back = FurtherPass(tracker, state, fitted=_fitted_shape(own, tracker, state, forward))
    for frame, before in zip(reversed(own.frames), reversed(forward), strict=True):
        yield back.step(frame.views, before.time_s, before.pose).estimate, frame.keypoints


def _fitted_shape(
    own: SimulatedSequence, tracker: Tracker, state: TrackerState, forward: Sequence[Estimate]
) -> FittedShape | None:
    """Proportions that the frames tell in which the hand is followed at least as well as in half of them; None where
    they tell none that are better than those before."""
    if not can_tell_shape(tracker):
        return None
    overlaps = torch.tensor([math.nan if one.overlap is None else one.overlap for one in forward])
    nowhere = torch.full((len(DOFS),), math.nan, dtype=torch.float64)
    poses = torch.stack([nowhere if one.pose is None else one.pose for one in forward])
    rows = frames_for_shape(poses, overlaps, tracker.settings.shape_frames)
    frames = [FollowedFrame(views=own.frames[row].views, time_s=forward[row].time_s, pose=poses[row]) for row in rows]
    found = recorded_shape(tracker, state, frames)
    return None if found is None or found.is_contradicted else found


def _sample(
    estimate: Estimate, keypoints: Float[Tensor, "21 3"], sequence: int, *, is_one_camera: bool = True
) -> FingerSample:
    assert estimate.keypoints is not None
    assert estimate.evidence is not None
    own, true = estimate.keypoints.numpy(), keypoints.numpy()
    return FingerSample(
        evidence=estimate.evidence,
        error_m=torch.from_numpy(fingertip_errors(own, true)),
        farthest_m=float(fingertip_distances(own, true, is_one_camera=is_one_camera).max()),
        sequence=sequence,
    )
