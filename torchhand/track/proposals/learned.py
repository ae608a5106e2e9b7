"""One camera: hands in any posture that a trained network proposes for the silhouette, registered on it."""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import torch
from jaxtyping import Bool
from torch import Tensor

from torchhand.files import load_proposal_network
from torchhand.fit import Appearance, Solutions
from torchhand.fit.detect import ContourFitter, NoStart, segment_hand, start_at_pose
from torchhand.fit.proposals import ProposalRegistration
from torchhand.geometry import cosine_between
from torchhand.hand import HandPose
from torchhand.image import BackgroundPlate, SilhouetteSettings, solidity
from torchhand.propose import Silhouette, propose_hands
from torchhand.track.knowledge import TrackerState
from torchhand.track.proposals.keypoints import fitter_of
from torchhand.track.proposals.protocol import Occasion, Proposals, Proposed
from torchhand.track.scene import Candidate, Scene, hand_end

_MIN_AREA = 0.004  # share of the picture that a silhouette fills at least
_MAX_SOLIDITY = 0.9
"""Area of a silhouette over that of its convex hull, beyond which it is no hand unless one is followed: some fist
explains every oval, so that faces would be hands. Ovals on necks have 0.93; nine of ten photographs of hands in any
posture, with their forearms, have less than 0.89, closed fists have more."""
_MIN_OVERLAP = 0.9  # of the first hand with the silhouette by its colours
_STARTS = 2  # registered hands whose colours are learned in the first picture
_TURNED = 0.5  # cosine of the angle between hands of different directions at most
_MIN_FOUND = 0.8  # share of the first hand's contour on edges
_RESTARTS = 3  # registered hands that a followed one is compared with


@dataclass(frozen=True, kw_only=True)
class LearnedHands:
    """Segments the picture, asks the network, registers all that it proposes, and hands on the cheapest.

    It is asked where the posture of the start was looked for in vain or leaves something unexplained. The first hand
    brings its colours, and its proportions where it shows them. A convex silhouette is no hand, as long as none is
    followed.
    """

    occasion: ClassVar[Occasion] = "degraded"
    fitter: ContourFitter
    """How the first hand is fitted; with a pinhole camera, which is the world."""
    silhouette: SilhouetteSettings
    can_start: bool = True
    """Whether the first hand may come from here; not where the user said where it is."""
    can_restart: bool = True
    """Whether later hands may; not where the posture is held, which is that of the first hand."""
    plate: BackgroundPlate | None = None

    @cached_property
    def _registration(self) -> ProposalRegistration:
        return ProposalRegistration(kinematics=self.fitter.kinematics)

    def __call__(self, scene: Scene, state: TrackerState, best: Candidate | None) -> Proposals:
        """Some hands; none in frames in which no search was or is due."""
        image = scene.views[0].image
        may_propose = self.can_restart if state.has_started else self.can_start
        if image is None or not (state.is_search_due and may_propose):
            return Proposals()
        mask = self._mask(scene, image, state)
        if float(mask.float().mean()) < _MIN_AREA or (best is None and solidity(mask) > _MAX_SOLIDITY):
            return Proposals()
        shape = self.fitter.shape if state.shape is None else state.shape
        if state.has_started and best is not None:
            mask = hand_end(mask, self._length_px(best, shape))
        found = self._registered(Silhouette(mask=mask, camera=self.fitter.camera, image=image), shape)
        if state.has_started:
            hands = tuple(Proposed(pose=found.pose[i]) for i in range(min(_RESTARTS, len(found.cost))))
            return Proposals(hands=hands, has_foreground=True)
        return self._first(found, image)

    def _length_px(self, hand: Candidate, shape: Tensor) -> float:
        """Length in the picture of a hand of some proportions at the place of another, held parallel to it."""
        camera, name = self.fitter.camera, "hand_length"
        depth = max(float(camera.cam_from_world(hand.palm)[2]), 1e-3)
        length = float(shape[self.fitter.kinematics.shape_space.names.index(name)])
        return length * float(camera.intrinsics[0, 0]) / depth

    def _registered(self, seen: Silhouette, shape: Tensor) -> Solutions:
        """Registered hypotheses: the cheapest, the cheapest of those that are turned away from it, then the rest by
        their cost."""
        hands = propose_hands(load_proposal_network(device=shape.device), (seen,), self.fitter.kinematics, shape)
        found = self._registration(seen, hands.pose[0], shape, weight=hands.weight[0])
        order = found.cost.argsort()
        order = order[found.cost[order].isfinite()]
        rotation = found.pose.rotation[order]
        rank = torch.arange(len(order))
        is_turned = cosine_between(rotation, rotation[:1]) < _TURNED
        rank[is_turned & (is_turned.cumsum(0) == 1)] = 0
        return found.rows(order[rank.argsort(stable=True)])

    def _first(self, found: Solutions, image: Tensor) -> Proposals:
        """The first hand with its colours, as it is refitted to the silhouette by these."""
        hands = []
        for index in range(min(_STARTS, len(found.cost))):
            pose = found.pose[index]
            start = start_at_pose(image, pose, fitter_of(pose, self.fitter))
            if isinstance(start, NoStart) or start.overlap < _MIN_OVERLAP or start.fit.found_fraction < _MIN_FOUND:
                continue
            fitted = HandPose.of(start.fit.pose, start.fit.root_reference)
            hands.append(Proposed(pose=fitted, shape=start.fit.shape, appearance=start.appearance))
        reason = "" if hands else "no proposed hand fits the silhouette"
        return Proposals(hands=tuple(hands), reason=reason, has_foreground=True)

    def _mask(self, scene: Scene, image: Tensor, state: TrackerState) -> Bool[Tensor, "height width"]:
        """Silhouette by what is known of the hand's colours."""
        if scene.masks[0] is not None:
            return scene.masks[0]
        known = state.appearance[0] if state.appearance else None
        appearance = known if isinstance(known, Appearance) else None
        return segment_hand(image, appearance, self.silhouette, self.plate)[0]
