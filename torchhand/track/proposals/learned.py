"""One camera: hands in any posture that a trained network proposes for the silhouette, registered on it."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import torch
from jaxtyping import Bool
from torch import Tensor

from torchhand.files import load_proposal_network
from torchhand.fit import Appearance, Solutions
from torchhand.fit.contour import is_in_picture
from torchhand.fit.detect import ContourFitter, NoStart, Start, coloured_at, segment_hand, start_at_pose
from torchhand.fit.proposals import ProposalRegistration
from torchhand.geometry import cosine_between
from torchhand.hand import HandPose
from torchhand.image import BackgroundPlate, SilhouetteSettings, solidity
from torchhand.propose import Silhouette, propose_hands
from torchhand.track.knowledge import TrackerState
from torchhand.track.proposals.keypoints import fitter_of
from torchhand.track.proposals.protocol import Occasion, Proposals, Proposed
from torchhand.track.scene import Candidate, Scene, View, hand_end
from torchhand.track.single import evidence_for, hand_odds
from torchhand.view import HandProjector

_MIN_AREA = 0.004  # share of the picture that a silhouette fills at least
_MAX_SOLIDITY = 0.9
"""Area of a silhouette over that of its convex hull, beyond which it is no hand unless one is followed: some fist
explains every oval, so that faces would be hands. Ovals on necks have 0.93; nine of ten photographs of hands in any
posture, with their forearms, have less than 0.89, closed fists have more."""
_STARTS = 2  # registered hands whose colours are learned in the first picture
_MIN_OVERLAP, _MIN_EDGES = 0.85, 0.7
"""Overlap of the first hand with the silhouette by its colours, and share of its contour on edges, at least."""
FALSE_STARTS = 0.02
"""Share of the pictures without a hand by which `HandOdds` was fitted whose log odds a first hand has to have."""
_FITS, _FALSE_STARTS_THAT_FIT = 0.93, 0.05
"""The same of a hand whose overlap and edges are so large."""
_PATIENCE = 10  # frames without a hand after which such a hand is believed whatever the odds
_NEXT_TO_PICTURE = 0.25  # of the way from the wrist to the middle finger's knuckle, in the picture
_TURNED = 0.5  # cosine of the angle between hands of different directions at most
_RESTARTS = 3  # registered hands that a followed one is compared with


def has_wrist_in_picture(fitter: ContourFitter, hands: HandPose) -> Bool[Tensor, "*batch"]:
    """Whether the wrists of hands, in the frame of the camera, lie in its picture, or next to it."""
    frames, camera = fitter.kinematics(hands.dofs, fitter.shape, root_reference=hands.reference), fitter.camera
    wrist, middle = camera.project(frames.keypoints[..., (0, 9), :]).unbind(-2)
    nearer = wrist + _NEXT_TO_PICTURE * (middle - wrist)
    return is_in_picture(nearer, camera)


@dataclass(frozen=True, kw_only=True)
class _NeededOdds:
    """Logarithms of the odds that a first hand has to have; minus infinity asks nothing."""

    usual: float
    of_fitting: float
    """Of a hand that fits the silhouette by its colours well (`_FITS`)."""

    @classmethod
    def of(cls, scene: Scene, state: TrackerState) -> "_NeededOdds":
        """Nothing is asked where the user says what the hand is, nor of what fits well where long nothing else came."""
        if scene.masks[0] is not None:
            return cls(usual=-math.inf, of_fitting=-math.inf)
        reached = hand_odds().reached
        is_late = state.searches_in_vain > _PATIENCE
        return cls(usual=reached[FALSE_STARTS], of_fitting=-math.inf if is_late else reached[_FALSE_STARTS_THAT_FIT])


@dataclass(frozen=True, kw_only=True)
class LearnedHands:
    """Segments the picture, asks the network, registers all that it proposes, and hands on the cheapest.

    It is asked where the posture of the start was looked for in vain or leaves something unexplained. The first hand
    brings its colours, and its proportions where it shows them; its wrist lies in the picture or next to it, for a
    bare forearm that leaves the picture looks like the palm of a larger hand. A convex silhouette is no hand, as long
    as none is followed.
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
        if scene.masks[0] is None:
            found = found.rows(has_wrist_in_picture(self.fitter, found.pose).nonzero()[:, 0])
        return self._first(found, image, _NeededOdds.of(scene, state))

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

    def _first(self, found: Solutions, image: Tensor, needed: _NeededOdds) -> Proposals:
        """The first hand with its colours, as it is refitted to the silhouette by these."""
        hands, reason = [], "no proposed hand fits the silhouette"
        for index in range(min(_STARTS, len(found.cost))):
            pose = found.pose[index]
            start = start_at_pose(image, pose, fitter_of(pose, self.fitter))
            if isinstance(start, NoStart) or start.overlap < _MIN_OVERLAP or start.fit.found_fraction < _MIN_EDGES:
                continue
            hand = Proposed.of_start(start)
            least = needed.of_fitting if min(start.overlap, start.fit.found_fraction) >= _FITS else needed.usual
            if least > -math.inf and (odds := self._odds(start, hand.pose, image)) < least:
                reason = f"something else is likelier than a hand (log odds {odds:.1f}, {least:.1f} expected)"
                continue
            hands.append(hand)
        return Proposals(hands=tuple(hands), reason="" if hands else reason, has_foreground=True)

    def _odds(self, start: Start, hand: HandPose, image: Tensor) -> float:
        """Logarithm of the odds that a hand is one, by what has the colours that it gives and touches it."""
        assert isinstance(start.appearance, Appearance)
        camera, kinematics, shape = self.fitter.camera, self.fitter.kinematics, start.fit.shape
        model = HandProjector(kinematics, camera, shape).silhouette(hand.dofs, hand.reference)
        mask = coloured_at(image, start.appearance, model)
        scene = Scene(views=(View(image=image, mask=mask),), masks=(mask,), probabilities=(None,), time_s=0.0)
        told = {"overlap": start.overlap, "edges": start.fit.found_fraction}
        return hand_odds()(evidence_for(hand, shape, scene, camera, kinematics, **told))

    def _mask(self, scene: Scene, image: Tensor, state: TrackerState) -> Bool[Tensor, "height width"]:
        """Silhouette by what is known of the hand's colours."""
        if scene.masks[0] is not None:
            return scene.masks[0]
        known = state.appearance[0] if state.appearance else None
        appearance = known if isinstance(known, Appearance) else None
        return segment_hand(image, appearance, self.silhouette, self.plate)[0]
