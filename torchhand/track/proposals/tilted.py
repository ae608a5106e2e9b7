"""One camera: the followed hand tilted otherwise, its fingers as they are or as a network sees them; with fingers bent
that stick out of the silhouette; and with those straightened that may cover a part of it which it leaves out."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.fit.contour import QUICK_SEARCH
from torchhand.fit.proposals import ProposalRegistration
from torchhand.geometry import Camera, rotation_from_vector
from torchhand.hand import FINGERS, JOINT_DOFS, HandKinematics, HandPose, posture
from torchhand.propose import Silhouette, palm_middle
from torchhand.track.knowledge import TrackerState
from torchhand.track.proposals.digits import PlacedDigits, moved_digits
from torchhand.track.proposals.protocol import Occasion, Proposals, Proposed
from torchhand.track.scene import Candidate, Scene, seen_silhouette

_TILTS = (-math.radians(30.0), 0.0, math.radians(30.0))
"""About either axis of the picture, and none: as far off as the network's view of a direction is."""
_COUNT = 4  # registered hands that the followed one is compared with
_AWAY = 0.4  # share of a digit beyond its first joint that lies outside the silhouette where it is elsewhere
_BENDING = [
    JOINT_DOFS.index(f"index_{name}") - JOINT_DOFS.index("index_cmc_fe") for name in ("mcp_fe", "pip_fe", "dip_fe")
]
_OVER = torch.diag(torch.tensor((-1.0, 1.0, -1.0), dtype=torch.float64))  # half a turn about the fingers' direction
_SAME_M = 0.005  # mean distance of keypoints, up to which two registered hands are one


@dataclass(frozen=True, kw_only=True)
class TiltedHands:
    """Other tilts of a hand that explains less than it did, all registered on the silhouette at once.

    Where fingers bend, tilt and flexion change an outline alike: a hand that is followed may slide into a tilt from
    which no small step leads back. Nor does one from a finger that was straight and lies outside the silhouette: bent
    a little it is as long; nor from a bent one to its place in the silhouette. Turned over a hand explains outlines as
    well: that is a search's matter.
    """

    occasion: ClassVar[Occasion] = "declining"
    kinematics: HandKinematics
    camera: Camera
    """A pinhole camera, which is the world."""

    @cached_property
    def _registration(self) -> ProposalRegistration:
        return ProposalRegistration(kinematics=self.kinematics, schedule=QUICK_SEARCH)

    def __call__(self, scene: Scene, state: TrackerState, best: Candidate | None) -> Proposals:
        """The cheapest hands that differ; none without a followed hand or a silhouette, nor beside a detector."""
        shape = state.shape
        if best is None or best.keypoints is not None or shape is None:
            return Proposals()
        seen = seen_silhouette(scene, self.camera)
        if seen is None:
            return Proposals()
        return self._registered(seen, self._starts(best, seen, shape), shape)

    def misplaced(self, best: Candidate | None, scene: Scene, shape: Float[Tensor, "shape"] | None) -> tuple[bool, ...]:
        """Digits of a followed hand that lie outside the silhouette, and those that may cover a part of it which the
        hand leaves out, 10 in all; empty where nothing tells."""
        if best is None or best.keypoints is not None or shape is None:
            return ()
        seen = seen_silhouette(scene, self.camera)
        if seen is None:
            return ()
        own = best.pose.normalized()
        return tuple(torch.cat(self._misplaced(own, seen, shape)).tolist())

    def _misplaced(
        self, pose: HandPose, seen: Silhouette, shape: Float[Tensor, "shape"]
    ) -> tuple[Bool[Tensor, "5"], Bool[Tensor, "5"]]:
        """Digits of a hand () that lie outside the silhouette, and those that may cover what it leaves out."""
        placed = PlacedDigits(self.kinematics, self.camera, HandPose.stack([pose]), shape, seen.mask)
        return placed.outside()[0] > _AWAY, placed.near_left_out()

    def turned_back(self, scene: Scene, shape: Float[Tensor, "shape"], turned: Candidate) -> Proposals:
        """What explains a picture as well as a hand that is turned over, from the side that was known: its other side
        in its place, each finger as the one that it takes the place of, and as a network sees it, in all tilts."""
        seen = seen_silhouette(scene, self.camera)
        if seen is None:
            return Proposals()
        own = turned.pose.normalized()
        joints = exchanged_fingers(own.dofs[-len(JOINT_DOFS) :])
        joints += [] if turned.learned is None else [turned.learned.joints]
        starts = tilted_hands(own, joints, self.kinematics, shape, turn=_OVER.to(own.reference))
        return self._registered(seen, starts, shape)

    def _registered(self, seen: Silhouette, starts: HandPose, shape: Float[Tensor, "shape"]) -> Proposals:
        """The cheapest of the registered starts (k) that differ."""
        found = self._registration(seen, starts, shape)
        order = found.cost.argsort()
        order = order[found.cost[order].isfinite()]
        keypoints = self.kinematics(found.pose.dofs, shape, root_reference=found.pose.reference).keypoints
        chosen: list[int] = []
        for row in order.tolist():
            apart = (keypoints[chosen] - keypoints[row]).norm(dim=-1).mean(-1)
            if len(chosen) < _COUNT and bool((apart > _SAME_M).all()):
                chosen.append(row)
        return Proposals(hands=tuple(Proposed(pose=found.pose[row]) for row in chosen), has_foreground=True)

    def _starts(self, best: Candidate, seen: Silhouette, shape: Float[Tensor, "shape"]) -> HandPose:
        """The followed hand tilted, with its own fingers and with those a network sees, and as it is with misplaced
        digits elsewhere."""
        own = best.pose.normalized()
        joints = [own.dofs[-len(JOINT_DOFS) :]]
        joints += [] if best.learned is None else [best.learned.joints]
        tilted = tilted_hands(own, joints, self.kinematics, shape)
        return HandPose.cat((tilted, *self.with_digits_elsewhere(own, seen, shape)))

    def with_digits_elsewhere(
        self, pose: HandPose, seen: Silhouette, shape: Float[Tensor, "shape"]
    ) -> tuple[HandPose, ...]:
        """A hand () with a zero rotation vector with those digits bent that lie outside the silhouette, and with those
        straightened that may cover what it leaves out."""
        outside, near_left_out = self._misplaced(pose, seen, shape)
        moved = (moved_digits(pose, outside, "fist"), moved_digits(pose, near_left_out, "open"))
        return tuple(one for one in moved if one is not None)


def exchanged_fingers(joints: Float[Tensor, "30"]) -> list[Float[Tensor, "30"]]:
    """Joint angles with which a hand shows from its other side about what one with these angles shows: its fingers bent
    as those in the same places, with the thumb or without it; else open."""
    own = joints.unflatten(0, (len(FINGERS), -1))
    found = []
    for places in ({1: 3, 2: 2, 3: 1}, {1: 4, 2: 3, 3: 2, 4: 1}):
        other = (
            posture("open", dtype=joints.dtype).to(joints.device)[-len(JOINT_DOFS) :].unflatten(0, own.shape).clone()
        )
        for finger, place in places.items():
            other[finger, _BENDING] = own[place, _BENDING]
        found.append(other.flatten())
    return found


def tilted_hands(
    pose: HandPose,
    joints: Sequence[Float[Tensor, "30"]],
    kinematics: HandKinematics,
    shape: Float[Tensor, "shape"],
    *,
    turn: Float[Tensor, "3 3"] | None = None,
) -> HandPose:
    """A hand () with a zero rotation vector tilted by 30° and by nothing about either axis of the picture through the
    middle of its palm, nine times with each of some postures; the camera is the world. turn: of the hand about its own
    axes before, the middle of its palm staying in place."""
    ways = list(itertools.product(joints, _TILTS, _TILTS))
    tilts = pose.dofs.new_tensor([(across, up, 0.0) for _, across, up in ways])
    dofs = torch.cat((pose.dofs.new_zeros(len(ways), 6), torch.stack([bent for bent, _, _ in ways])), 1)
    rotation = rotation_from_vector(tilts) @ (pose.rotation if turn is None else pose.rotation @ turn)
    tilted, own = (
        palm_middle(kinematics(one, shape, root_reference=turned).keypoints)
        for one, turned in ((dofs, rotation), (pose.dofs[None], pose.reference[None]))
    )
    dofs[:, :3] = own - tilted
    return HandPose(dofs=dofs, reference=rotation)
