"""One camera: the followed hand tilted otherwise, its fingers as they are or as a network sees them."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.fit.contour import QUICK_SEARCH
from torchhand.fit.proposals import ProposalRegistration
from torchhand.geometry import Camera, rotation_from_vector
from torchhand.hand import JOINT_DOFS, HandKinematics, HandPose
from torchhand.propose import Silhouette, palm_middle
from torchhand.track.knowledge import TrackerState
from torchhand.track.proposals.protocol import Occasion, Proposals, Proposed
from torchhand.track.scene import Candidate, Scene

_TILTS = (-math.radians(30.0), 0.0, math.radians(30.0))
"""About either axis of the picture, and none: as far off as the network's view of a direction is."""
_COUNT = 4  # registered hands that the followed one is compared with
_SAME_M = 0.005  # mean distance of keypoints, up to which two registered hands are one


@dataclass(frozen=True, kw_only=True)
class TiltedHands:
    """Other tilts of a hand that explains less than it did, all registered on the silhouette at once.

    Where fingers bend, tilt and flexion change an outline alike: a hand that is followed may slide into a tilt from
    which no small step leads back. Turned over it explains outlines as well: that is a search's matter.
    """

    kinematics: HandKinematics
    camera: Camera
    """A pinhole camera, which is the world."""

    @property
    def occasion(self) -> Occasion:
        return "declining"

    @cached_property
    def _registration(self) -> ProposalRegistration:
        return ProposalRegistration(kinematics=self.kinematics, schedule=QUICK_SEARCH)

    def __call__(self, scene: Scene, state: TrackerState, best: Candidate | None) -> Proposals:
        """The cheapest hands that differ; none without a followed hand or a silhouette, nor beside a detector."""
        plane, shape = scene.plane(0), state.shape
        if best is None or best.keypoints is not None or shape is None:
            return Proposals()
        if plane is None or not bool((plane > 0.5).any()):
            return Proposals()
        seen = Silhouette(mask=plane > 0.5, camera=self.camera, image=scene.views[0].image)
        found = self._registration(seen, self._starts(best, shape), shape)
        order = found.cost.argsort()
        order = order[found.cost[order].isfinite()]
        keypoints = self.kinematics(found.pose.dofs, shape, root_reference=found.pose.reference).keypoints
        chosen: list[int] = []
        for row in order.tolist():
            apart = (keypoints[chosen] - keypoints[row]).norm(dim=-1).mean(-1)
            if len(chosen) < _COUNT and bool((apart > _SAME_M).all()):
                chosen.append(row)
        return Proposals(hands=tuple(Proposed(pose=found.pose[row]) for row in chosen), has_foreground=True)

    def _starts(self, best: Candidate, shape: Float[Tensor, "shape"]) -> HandPose:
        """The followed hand, with its own fingers and with those a network sees."""
        own = best.pose.normalized()
        joints = [own.dofs[-len(JOINT_DOFS) :]]
        joints += [] if best.learned is None else [best.learned.joints]
        return tilted_hands(own, joints, self.kinematics, shape)


def tilted_hands(
    pose: HandPose, joints: Sequence[Float[Tensor, "30"]], kinematics: HandKinematics, shape: Float[Tensor, "shape"]
) -> HandPose:
    """A hand () with a zero rotation vector tilted by 30° and by nothing about either axis of the picture through the
    middle of its palm, nine times with each of some postures; the camera is the world."""
    ways = list(itertools.product(joints, _TILTS, _TILTS))
    tilts = pose.dofs.new_tensor([(across, up, 0.0) for _, across, up in ways])
    dofs = torch.cat((pose.dofs.new_zeros(len(ways), 6), torch.stack([bent for bent, _, _ in ways])), 1)
    rotation = rotation_from_vector(tilts) @ pose.rotation
    tilted, own = (
        palm_middle(kinematics(one, shape, root_reference=turned).keypoints)
        for one, turned in ((dofs, rotation), (pose.dofs[None], pose.reference[None]))
    )
    dofs[:, :3] = own - tilted
    return HandPose(dofs=dofs, reference=rotation)
