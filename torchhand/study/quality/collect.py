"""The evidence for fingers of tracked simulated hands, and how far their tips are off."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.devices import HOST, sent_to
from torchhand.evaluate import fingertip_distances, fingertip_errors
from torchhand.files import load_hand_model
from torchhand.geometry import rotation_from_vector
from torchhand.hand import FINGERS, HandKinematics, HandPose
from torchhand.study import seed_of
from torchhand.study.quality.sequences import FPS, SimulatedSequence, drawn_posture, sequence
from torchhand.track import Estimate, Tracker, TrackerSettings, TrackerState
from torchhand.track.single import SinglePoseFitter

_NEVER = 10**6  # frames
FRAMES = 12
"""Pictures of a sequence."""
_PER_FINGER = 6  # joint angles
_ROOT = 6
_OTHERWISE = 0.5  # share of the fingers that start in another posture
_FLIPPED = 0.15  # share of the hands that start with palm and back exchanged
_ROOT_STD_M, _ROOT_STD_DEG, _ANGLE_STD_DEG = 0.004, 4.0, 6.0


@dataclass(frozen=True, kw_only=True)
class FingerSample:
    """One estimate of a tracked simulated hand."""

    evidence: Float[Tensor, "5 evidence"]
    error_m: Float[Tensor, "5"]
    """Distance of each fingertip from the truth, as `fingertip_errors` has it."""
    farthest_m: float
    """Distance of the worst fingertip across the line of sight."""
    sequence: int
    """Number of the sequence."""


def collect(
    settings: TrackerSettings, count: int, seed: int, device: torch.device = HOST
) -> Iterator[list[FingerSample]]:
    """The estimates of each of `count` sequences, every other one with the points of a detector.

    Trackers start beside the truth: some degrees off, with some fingers in another posture, or turned over; what they
    make of that is theirs. Only following is measured, without searches. The same seed gives the same samples.
    device: of the tracker.
    """
    health = replace(settings.health, search_every=_NEVER, search_at_most_every=_NEVER, searches_when_failing=False)
    settings = replace(settings, learned_proposals=False, health=health)
    kinematics = load_hand_model().kinematics("right", dtype=torch.float64)
    hand = load_hand_model().to(device=device).hand(side="right", dtype=torch.float64)
    for index in range(count):
        generator = torch.Generator().manual_seed(seed_of(seed, "quality", index))
        own = sequence(generator, FRAMES, has_detector=index % 2 == 1)
        if own is None:
            yield []
            continue
        tracker = Tracker(hand, own.camera, settings, shape=own.shape)
        start = _beside(own, kinematics, generator)
        yield [_sample(estimate, keypoints, index) for estimate, keypoints in _tracked(own, tracker, start)]


def collect_single(fitter: SinglePoseFitter, count: int, seed: int) -> Iterator[list[FingerSample]]:
    """The same of single pictures: the first of each sequence, every other one with the points of a detector."""
    for index in range(count):
        generator = torch.Generator().manual_seed(seed_of(seed, "single quality", index))
        own = sequence(generator, 1, has_detector=index % 2 == 1)
        if own is None:
            yield []
            continue
        estimate = fitter(own.frames[0].view, own.camera).estimate
        yield [] if estimate.evidence is None else [_sample(estimate, own.frames[0].keypoints, index)]


def _tracked(
    own: SimulatedSequence, tracker: Tracker, start: HandPose
) -> Iterator[tuple[Estimate, Float[Tensor, "21 3"]]]:
    """The estimates of all pictures after the first, until the hand is lost."""
    begun = TrackerState(shape=own.shape, appearance=(own.appearance,), posture=start.dofs, has_started=True)
    empty, start, shape = sent_to((begun, start, own.shape), tracker.device)
    found = tracker.candidate(start, tracker.scene(empty, [own.frames[0].view], 0.0), shape)
    if found is None:
        return
    state = replace(empty, hand=found.hand, time_s=0.0)
    for number, frame in enumerate(own.frames[1:], 1):
        state, estimate = tracker.step(state, [frame.view], number / FPS)
        if estimate.pose is None:
            return
        yield estimate, frame.keypoints


def _beside(own: SimulatedSequence, kinematics: HandKinematics, generator: torch.Generator) -> HandPose:
    """A start beside the truth."""
    other = drawn_posture(kinematics, generator)
    takes = torch.rand(len(FINGERS), generator=generator) < _OTHERWISE
    share = torch.where(takes, torch.rand(len(FINGERS), generator=generator), 0.0).repeat_interleave(_PER_FINGER)
    dofs = own.start.dofs.clone()
    dofs[_ROOT:] = torch.lerp(dofs[_ROOT:], other, share.to(dofs))
    dofs[_ROOT:] += math.radians(_ANGLE_STD_DEG) * torch.randn(30, generator=generator, dtype=torch.float64)
    dofs[_ROOT:] = kinematics.skeleton.within_limits(dofs[_ROOT:])
    dofs[:3] += _ROOT_STD_M * torch.randn(3, generator=generator, dtype=torch.float64)
    turn = math.radians(_ROOT_STD_DEG) * torch.randn(3, generator=generator, dtype=torch.float64)
    rotation = rotation_from_vector(turn) @ own.start.rotation
    if float(torch.rand((), generator=generator)) < _FLIPPED:
        over = torch.tensor((0.0, math.pi, 0.0), dtype=torch.float64)  # about the axis of the palm
        rotation = rotation @ rotation_from_vector(over)
    dofs[3:_ROOT] = 0
    return HandPose.of(dofs, rotation)


def _sample(estimate: Estimate, keypoints: Float[Tensor, "21 3"], sequence: int) -> FingerSample:
    assert estimate.keypoints is not None
    assert estimate.evidence is not None
    own, true = estimate.keypoints.numpy(), keypoints.numpy()
    return FingerSample(
        evidence=estimate.evidence,
        error_m=torch.from_numpy(fingertip_errors(own, true)),
        farthest_m=float(fingertip_distances(own, true, is_one_camera=True).max()),
        sequence=sequence,
    )
