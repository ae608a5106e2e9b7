"""Other hands that explain one camera's picture: how probable each is, by all that is known of it in nats.

An outline that fits best is not the likeliest hand: where fingers bend, tilt and flexion change it alike, and what is
known of postures, of the network's view and of edges that err together decides, or leaves it open.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.fit import Observation, PosedHands, Solutions, solve
from torchhand.fit.contour import QUICK_SEARCH
from torchhand.fit.keypoints import PostureKeypoints
from torchhand.hand import JOINT_DOFS, HandPose
from torchhand.numerics import single_threaded
from torchhand.track.knowledge import TrackerState
from torchhand.track.proportions import contour_settings
from torchhand.track.proposals import PlacedDigits, tilted_hands
from torchhand.track.scene import Scene, learned_observations, seen_posture, seen_silhouette
from torchhand.track.tracker import Tracker

SAME_M = 0.005  # mean distance of keypoints, up to which two registered hands are one
_OUTSIDE_NATS, _OUTSIDE = 4.5, 0.3
"""Nats against a hand for each digit of which a larger share lies outside the silhouette: among 3,008 digits that are
right in either pass 1 in 1,500, among 166 whose tips are 20 mm off 1 in 17 (`rom_back`, `rom_side`, `rom_palm`,
`free`)."""
_LEFT_OUT_NATS = 4.5
"""Nats against one that leaves out a part as thick as a digit: so do 4 of 1,919 hands that are right and 53 of 234 of
which a tip is 20 mm off (the same, `flexion`, and parts of `free`, as they are and halved)."""
_UNTOLD = 0.1  # share of pictures in which the network's hypotheses tell nothing of the direction


@dataclass(frozen=True, kw_only=True)
class Alternatives:
    """Hands that differ and explain one picture, the likeliest first."""

    pose: HandPose
    """(k), in the world, with zero rotation vectors."""
    keypoints: Float[Tensor, "k 21 3"]
    """Metres."""
    cost: Float[Tensor, "k"]
    """Nats, every point of the contours by itself."""
    correlated_cost: Float[Tensor, "k"]
    """Nats, the errors of points of a contour being correlated (`UpdateRule.overconfidence`): what it leaves open."""
    row: tuple[int, ...]
    """Which of them each of the given hands becomes where it is registered as they are."""


class TiltAlternatives:
    """Registers a followed hand, tilted otherwise and as it is, on the picture, all at once."""

    def __init__(self, tracker: Tracker, state: TrackerState) -> None:
        """tracker: of one pinhole camera, one whose hands can be tilted (`can_tilt`). state: with the proportions and
        the hand's colours."""
        assert state.shape is not None
        self._tracker, self._shape = tracker, state.shape
        contours = contour_settings(tracker.settings.update)
        self._fit = tracker.parts.frame_fit(state.shape, QUICK_SEARCH, contours)

    @staticmethod
    def can_tilt(tracker: Tracker) -> bool:
        """Whether a tracker compares its hand with tilted ones."""
        return tracker.parts.tilts is not None

    @torch.inference_mode()
    @single_threaded()
    def __call__(self, scene: Scene, hands: Sequence[HandPose]) -> Alternatives | None:
        """hands: poses () with zero rotation vectors, the followed one first. None where nothing of its contour is seen
        and beside a detector, which tells of tilts."""
        parts, followed, shape = self._tracker.parts, hands[0], self._shape
        outline = None if parts.keypoints(scene).observations else self._fit.contour(scene, followed)
        if outline is None:
            return None
        seen = seen_posture(scene, parts.cameras[0], parts.kinematics, followed, shape)
        observations: list[Observation] = [outline]
        joints = [followed.dofs[-len(JOINT_DOFS) :]]
        if seen is not None:
            told = learned_observations(seen, followed)
            observations += [one for one in told if isinstance(one, PostureKeypoints)]
            joints.append(seen.joints)
        silhouette = seen_silhouette(scene, parts.cameras[0])
        others = [tilted_hands(followed, joints, parts.kinematics, shape)]
        if parts.tilts is not None and silhouette is not None:
            others += parts.tilts.with_digits_elsewhere(followed, silhouette, shape)
        starts = HandPose.cat((HandPose.stack(hands), *others))
        found = solve(self._fit.hypotheses(observations), starts, QUICK_SEARCH)
        found = replace(found, pose=found.pose.normalized())
        if seen is not None:
            agreement = torch.stack([seen.direction_agreement(one) for one in found.pose.rotation])
            found = replace(found, cost=found.cost - (agreement.to(found.cost) + _UNTOLD).log())
        found = replace(found, cost=found.cost + misplaced_nats(self._tracker, scene, found.pose, shape))
        alone = found.misfit - sum(self._nats(one, found.pose) for one in observations[1:])
        return self._different(found, alone, len(hands))

    def _nats(self, observation: Observation, poses: HandPose) -> Float[Tensor, "k"]:
        """What an observation costs hands in which nothing is to be associated."""
        hands = PosedHands(pose=poses, shape=self._shape)
        return observation.associate(hands, QUICK_SEARCH[-1]).equations(hands).cost

    def _different(self, found: Solutions, contour: Float[Tensor, "k"], given: int) -> Alternatives | None:
        """Those that differ, the cheapest first; None where one of the first few, which were given, is none. contour:
        nats of the contours alone."""
        shape, order = self._shape, found.cost.argsort().tolist()
        if not bool(found.cost[:given].isfinite().all()):
            return None
        common = 1 - 1 / self._tracker.parts.rule.overconfidence
        keypoints = self._tracker.kinematics(found.pose.dofs, shape, root_reference=found.pose.reference).keypoints
        chosen: list[int] = []
        place: dict[int, int] = {}
        for row in order[: int(found.cost.isfinite().sum())]:
            apart = (keypoints[chosen] - keypoints[row]).norm(dim=-1).mean(-1)
            is_new = not bool((apart <= SAME_M).any())
            place[row] = len(chosen) if is_new else int(apart.argmin())
            chosen += [row] if is_new else []
        return Alternatives(
            pose=found.pose[torch.tensor(chosen)],
            keypoints=keypoints[chosen],
            cost=found.cost[chosen],
            correlated_cost=(found.cost - common * contour)[chosen],
            row=tuple(place[row] for row in range(given)),
        )


def misplaced_nats(
    tracker: Tracker, scene: Scene, poses: HandPose, shape: Float[Tensor, "shape"]
) -> Float[Tensor, "k"]:
    """What speaks against hands (k) in about one place whose digits lie outside the silhouette, or leave a part of it
    out, where one camera tells: contours and overlaps hardly show it."""
    parts = tracker.parts
    seen = None if parts.tilts is None else seen_silhouette(scene, parts.cameras[0])
    if seen is None or not len(poses):
        return poses.dofs.new_zeros(len(poses))
    placed = PlacedDigits(parts.kinematics, parts.cameras[0], poses, shape, seen.mask)
    outside = _OUTSIDE_NATS * (placed.outside() > _OUTSIDE).sum(-1)
    return (outside + _LEFT_OUT_NATS * placed.leave_out()).to(poses.dofs)
