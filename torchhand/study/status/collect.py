"""The evidence of candidates: hands where they are, elsewhere or otherwise, and where there are none."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, get_args

import torch
from torch import Tensor

from torchhand.devices import HOST, sent_to
from torchhand.files import load_hand_model
from torchhand.fit.detect import align_posture
from torchhand.geometry import rotation_from_vector
from torchhand.hand import HandPose
from torchhand.simulate import hand_length
from torchhand.study import seed_of
from torchhand.study.status.scenes import Picture, named_joints, picture, placed, without_hand
from torchhand.track import Tracker, TrackerSettings
from torchhand.track.scene import Candidate, Health, Scene

Kind = Literal["right", "wrong", "none"]
KINDS: tuple[Kind, ...] = get_args(Kind)
"""The hand where it is; a hand that is another; no hand in the picture."""

_RIGHT = 0.06  # mean error of the keypoints in the picture up to which a hand is the right one, hand lengths
_WRONG = 0.15  # and from which on it is another one
_MIN_AREA = 0.004  # share of the picture with the hand's colours, below which a search does not begin
_INSIDE = 0.8  # share of its keypoints that lies in the picture, below which a search does not propose a hand


@dataclass(frozen=True, kw_only=True)
class Sample:
    """One candidate and what is known of it."""

    kind: Kind
    candidate: Candidate


def collect(settings: TrackerSettings, count: int, seed: int, device: torch.device = HOST) -> Iterator[Sample]:
    """Candidates of a tracker's update rule on `count` simulated pictures, up to one of each kind from each.

    The right hand starts some degrees and millimetres beside the truth; the wrong ones in another posture, turned, or
    half beside it at another size; where there is none, as a search lays a posture over what has the hand's colours.
    What an update leaves between right and wrong counts as neither. The same seed gives the same candidates.
    device: of the updates; candidates come back to the processor.
    """
    hand = load_hand_model().to(device=device).hand(side="right", dtype=torch.float64)
    for index in range(count):
        generator = torch.Generator().manual_seed(seed_of(seed, "status", index))
        own = picture(generator)
        if own is None:
            continue
        tracker = Tracker(hand, own.camera, settings, shape=own.believed_shape)
        scene = own.scene(own.image)
        for start in (_near(own, generator), _elsewhere(own, generator)):
            found = _candidate(tracker, start, scene, own)
            kind = None if found is None else _kind(own, found)
            if found is not None and kind is not None:
                yield Sample(kind=kind, candidate=found)
        found = _without(own, tracker, generator)
        if found is not None:
            yield Sample(kind="none", candidate=found)


def _candidate(tracker: Tracker, start: HandPose, scene: Scene, own: Picture) -> Candidate | None:
    """What the update makes of a start, on the tracker's device."""
    given = sent_to((start, scene, own.believed_shape), tracker.device)
    return sent_to(tracker.candidate(*given), HOST)


def _kind(own: Picture, found: Candidate) -> Kind | None:
    error = float((own.keypoints_of(found.pose) - own.keypoints_px).norm(dim=-1).mean()) / own.length_px
    return "right" if error <= _RIGHT else "wrong" if error >= _WRONG else None


def _near(own: Picture, generator: torch.Generator) -> HandPose:
    dofs = own.pose.dofs.clone()
    dofs[:3] += 0.004 * torch.randn(3, generator=generator, dtype=torch.float64)
    dofs[3:6] += math.radians(4.0) * torch.randn(3, generator=generator, dtype=torch.float64)
    dofs[6:] += math.radians(5.0) * torch.randn(30, generator=generator, dtype=torch.float64)
    dofs[6:] = own.kinematics.skeleton.within_limits(dofs[6:])
    return HandPose.of(dofs, own.pose.reference)


def _elsewhere(own: Picture, generator: torch.Generator) -> HandPose:
    """Another posture in its place, the hand turned in the picture, or half over it at another size."""
    pick = int(torch.randint(0, 3, (), generator=generator))
    length = hand_length(own.kinematics, own.shape)
    if pick == 0:
        dofs = own.pose.dofs.clone()
        dofs[6:] = named_joints(generator)[6:]
        return HandPose.of(dofs, own.pose.reference)
    share = float(torch.rand((), generator=generator, dtype=torch.float64))
    if pick == 1:
        turn = torch.tensor((0.0, 0.0, math.radians(60 + 240 * share)), dtype=torch.float64)
        return _about_the_middle(own.pose, rotation_from_vector(turn), length)
    size = (0.35 + 0.5 * share) * own.length_px / own.camera.height
    other = placed(own.camera, length, named_joints(generator), generator, size=size)
    target = own.keypoints_px[[9, 10, 14, 12, 6][int(torch.randint(0, 5, (), generator=generator))]]
    depth = float(other.dofs[2])
    dofs = other.dofs.clone()
    middle = own.keypoints_of(other)[[0, 12]].mean(0)
    dofs[:2] += depth * (target - middle) / float(own.camera.intrinsics[0, 0])
    return HandPose.of(dofs, other.reference)


def _about_the_middle(pose: HandPose, turn: Tensor, length: float) -> HandPose:
    middle = torch.tensor((0.0, 0.48 * length, 0.0), dtype=torch.float64)
    dofs = pose.dofs.clone()
    dofs[:3] = dofs[:3] + pose.rotation @ middle - turn @ pose.rotation @ middle
    dofs[3:6] = 0
    return HandPose.of(dofs, turn @ pose.rotation)


def _without(own: Picture, tracker: Tracker, generator: torch.Generator) -> Candidate | None:
    """The best of a few candidates where a search lays a posture over the silhouette."""
    scene: Scene = own.scene(without_hand(own, generator))
    plane = scene.plane(0)
    if plane is None or float((plane > 0.5).double().mean()) < _MIN_AREA:
        return None
    health = Health(settings=tracker.settings.health)
    best: Candidate | None = None
    for alignment in align_posture(
        plane > 0.5, own.camera, own.kinematics, own.believed_shape, named_joints(generator)
    )[:2]:
        start = HandPose.of(alignment.pose, alignment.root_reference)
        points = own.keypoints_of(start)
        size = torch.tensor((own.camera.width, own.camera.height))
        if float(((points >= 0) & (points < size)).all(-1).double().mean()) < _INSIDE:
            continue
        found = _candidate(tracker, start, scene, own)
        if found is not None and (best is None or health.score(found) > health.score(best)):
            best = found
    return best
