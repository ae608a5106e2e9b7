"""Hands fitted to the silhouettes of one moment: from a prediction, from hands of other moments, or without a guess."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.fit import GaussianPrior, PostureResiduals, Solutions, Stage
from torchhand.fit.hull import (
    HullEvidence,
    HullFitter,
    JointPriors,
    find_in_hull,
    finger_proposals,
    fit_by_torques,
    palm_of,
)
from torchhand.geometry import Camera, rotation_from_vector
from torchhand.hand import ConstraintSettings, Hand, HandPose, HandPrior, PoseConstraints, named_pose_space
from torchhand.track.multiview.hulls import Hull, Hulls
from torchhand.track.multiview.settings import RigSettings
from torchhand.track.scene import Masks, SilhouetteComparison, mean_overlap

_KNUCKLE = 9  # keypoint about which the hull is carved: the middle finger's
_SETTLING = (
    Stage(gross_m=0.012, rounds=2, iterations=2),
    Stage(gross_m=0.005, rounds=2, iterations=2),
    Stage(gross_m=0.002, rounds=1, iterations=3),
)
_TURNS = (
    *((0.0, angle, 0.0) for angle in (-90.0, -60.0, -30.0, 30.0, 60.0, 90.0)),
    *((angle, 0.0, 0.0) for angle in (-30.0, 30.0)),
    *((0.0, 0.0, angle) for angle in (-25.0, 25.0)),
)
"""Degrees about the hand's axes: mostly about that of the forearm."""
_ALIKE = 0.25  # of what the best leaves unexplained: scores that differ by less are alike, and the cost decides


@dataclass(frozen=True, kw_only=True)
class Anchor:
    """A hand found in some moment, to start from there in others."""

    pose: Float[Tensor, "36"]
    """With a zero rotation vector; metres and radians, world frame."""
    root_reference: Float[Tensor, "3 3"]


@dataclass(frozen=True, kw_only=True)
class HullFit:
    """One hand fitted into a hull."""

    pose: Float[Tensor, "36"]
    """With a zero rotation vector; metres and radians, world frame."""
    root_reference: Float[Tensor, "3 3"]
    """world_from_hand"""
    cost: Float[Tensor, ""]
    """Nats; infinite if the fit failed."""
    covariance: Float[Tensor, "free free"]
    """Of the free parameters, the rotation as a left perturbation of the reference; NaN if the fit failed."""
    inside_share: float
    """Share of the skin inside the hull (the rate of convergence of Ueda et al. 2003)."""
    covered_share: float
    """Share of the silhouettes' edges that the skin explains."""
    is_good: bool
    """Whether a hand is there as fitted."""

    @classmethod
    def of(cls, found: Solutions) -> "HullFit":
        """Of one hypothesis, without batch dimensions."""
        evidence = HullEvidence.of(found)
        return cls(
            pose=found.pose.dofs,
            root_reference=found.pose.reference,
            cost=found.cost,
            covariance=found.covariance,
            inside_share=float(evidence.inside),
            covered_share=float(evidence.covered),
            is_good=bool(evidence.is_good),
        )


@dataclass(frozen=True, kw_only=True)
class Placed:
    """A fitted hand and how the silhouettes bear it out."""

    fit: HullFit
    overlaps: Float[Tensor, "views"]
    """Intersection over union in every view, NaN where one is missing."""

    @property
    def overlap(self) -> float:
        """Mean over the views."""
        return mean_overlap(self.overlaps)

    @property
    def score(self) -> float:
        """How much of the pictures it explains, as `score_of`."""
        return score_of(self.overlap, self.fit.covered_share)

    @property
    def views(self) -> int:
        """How many views it is compared with."""
        return int(self.overlaps.isfinite().sum())

    @property
    def anchor(self) -> Anchor:
        return Anchor(pose=self.fit.pose, root_reference=self.fit.root_reference)


@dataclass(frozen=True, kw_only=True)
class _Made:
    """What fits a hand of some proportions."""

    near: HullFitter
    """From a prediction, or a pose that differs by one digit."""
    settling: HullFitter
    """From one that may be 10 mm off."""
    broad: HullFitter
    """From starts that may be farther off."""
    comparison: SilhouetteComparison


class MomentFitter:
    """Everything that fits one hand to the silhouettes of one moment, for a fixed rig."""

    def __init__(self, hand: Hand, cameras: Sequence[Camera], settings: RigSettings) -> None:
        """hand: in float64. cameras: without distortion.

        Raises ValueError for cameras that see no volume together where no cube is given.
        """
        self.hand, self.settings = hand, settings
        self.cameras = tuple(camera.to(dtype=torch.float64) for camera in cameras)
        self.hulls = Hulls(self.cameras, settings.octree, min_views=settings.min_views, contours=settings.contours)
        self.space = named_pose_space(settings.pose_space)
        skeleton = hand.kinematics.skeleton
        self.joints = JointPriors(
            # One finger bent beside straight ones is told by the silhouettes; the bands between the knuckles' flexions
            # (Ouhaddi and Horain 1998, eq. 3) would forbid it.
            constraints=PoseConstraints(skeleton, ConstraintSettings(bands="none")),
            postures=PostureResiduals.of(HandPrior(skeleton, hand.kinematics.shape_space).postures),
            weights=settings.joints,
        )
        self._made: _Made | None = None

    def hull_about(self, anchor: Anchor, shape: Float[Tensor, "shape"], masks: Masks) -> Hull:
        """The hull where a hand is, or is expected."""
        hand = self.hand.kinematics(anchor.pose, shape, root_reference=anchor.root_reference)
        return self.hulls.near(masks, hand.keypoints[_KNUCKLE])

    def hull_anywhere(self, shape: Float[Tensor, "shape"] | None, masks: Masks) -> Hull:
        """What may be the hand in all that the silhouettes show, arm included; for a shape, or the largest tried."""
        space = self.hand.kinematics.shape_space
        if shape is None:
            length = max(self.settings.sizes) * float(space.metric(self.hand.kinematics.default_shape)["hand_length"])
        else:
            length = float(space.metric(shape)["hand_length"])
        return self.hulls.anywhere(masks, hand_length=length)

    def expected(
        self,
        hull: Hull,
        starts: Sequence[Anchor],
        mean: Float[Tensor, "free"],
        covariance: Float[Tensor, "free free"],
        shape: Float[Tensor, "shape"],
        masks: Masks,
    ) -> Placed | None:
        """The hand fitted with a prediction, the best of some starts; None without a hull.

        starts: the first is the prediction itself. mean, covariance: of the prediction in the free parameters, about
        the root reference of the first start.
        """
        if hull.target is None:
            return None
        near = self._made_for(shape).near
        if self.settings.fitting == "torque":
            pulled = fit_by_torques(
                hull.target.field, near.vertices.skin, self.space, _stacked(starts[:1]), self.settings.torque
            )
            judged = near(hull.target, pulled.pose)  # how sure it is, and how good
            found = replace(judged, pose=pulled.pose)
        else:
            prediction = HandPose.of(self.space.dof(mean), starts[0].root_reference)
            belief = GaussianPrior.of_covariance(prediction, covariance, self.space)
            found = near(hull.target, _stacked(starts), belief)
        return self._placed(found.select(found.best), shape, masks)

    def from_anchors(
        self, hull: Hull, anchors: Sequence[Anchor], shape: Float[Tensor, "shape"], masks: Masks
    ) -> Placed | None:
        """The best of the hands fitted from some that may be a good way off; None without a hull or an anchor."""
        return self._best(self._made_for(shape).broad, hull, _stacked(anchors), shape, masks) if anchors else None

    def settled(self, hull: Hull, anchor: Anchor, shape: Float[Tensor, "shape"], masks: Masks) -> Placed | None:
        """The hand fitted from one that is nearly right, the better of small steps, after which digits stay where they
        are, and large ones."""
        made = self._made_for(shape)
        start = _stacked([anchor])
        return chosen([self._best(own, hull, start, shape, masks) for own in (made.settling, made.broad)])

    def in_place(
        self, hull: Hull, anchor: Anchor, others: Sequence[Anchor], shape: Float[Tensor, "shape"], masks: Masks
    ) -> list[Placed]:
        """Hands fitted from one, and from where others would be if their palms were where its is."""
        if hull.target is None:
            return []
        palm = self._palm(anchor, shape)
        moved = [
            replace(other, pose=torch.cat((other.pose[:3] + palm - self._palm(other, shape), other.pose[3:])))
            for other in others
        ]
        found = self._made_for(shape).broad(hull.target, _stacked([anchor, *moved]))
        return [self._placed(found.select(index), shape, masks) for index in found.is_sound.nonzero()[:, 0].tolist()]

    def _palm(self, anchor: Anchor, shape: Tensor) -> Float[Tensor, "3"]:
        points = self.hand.kinematics(anchor.pose, shape, root_reference=anchor.root_reference).keypoints
        return palm_of(points)

    def with_other_digits(
        self, hull: Hull, anchor: Anchor, others: Sequence[Anchor], shape: Float[Tensor, "shape"], masks: Masks
    ) -> Placed | None:
        """The best of the hands in one place, with single digits in other postures or in the postures of others; the
        cheapest after small steps go on from there."""
        if hull.target is None:
            return None
        pose = HandPose(dofs=anchor.pose, reference=anchor.root_reference)
        postures = [torch.cat((anchor.pose[:6], other.pose[6:])) for other in others]
        tried = HandPose.of(torch.stack([*finger_proposals(pose).dofs, *postures]), anchor.root_reference)
        made = self._made_for(shape)
        found = made.near(hull.target, tried)
        cheapest = found.pose[found.cost.argsort()[: self.settings.start.fine]]
        return self._best(made.settling, hull, cheapest, shape, masks)

    def turned(self, hull: Hull, anchor: Anchor, shape: Float[Tensor, "shape"], masks: Masks) -> Placed | None:
        """The best of the hands turned about the palm from where one is, such as after a fast turn of the forearm."""
        palm = self._palm(anchor, shape)
        turns = torch.deg2rad(torch.tensor(_TURNS, dtype=anchor.pose.dtype))
        references = rotation_from_vector(turns @ anchor.root_reference.mT) @ anchor.root_reference
        moved = palm + references @ (anchor.root_reference.mT @ (anchor.pose[:3] - palm))
        tried = HandPose.of(torch.cat((moved, anchor.pose[3:].expand(len(moved), -1)), -1), references)
        return self._best(self._made_for(shape).settling, hull, tried, shape, masks)

    def searched(self, hull: Hull, shape: Float[Tensor, "shape"], masks: Masks) -> Placed | None:
        """The best of a search without any guess; None where nothing can be looked for."""
        if hull.target is None:
            return None
        found = find_in_hull(hull.target, self._made_for(shape).broad, shape[None], self.settings.start)
        return chosen([self._placed(one.found, shape, masks) for one in found])

    def shape_fitter(self, shape: Float[Tensor, "shape"] | None) -> HullFitter:
        """With which proportions are fitted, from those given or from the hand's own."""
        weights = replace(self.settings.joints, postures=self.settings.shape_posture_weight)
        return HullFitter(
            hand=self.hand,
            space=self.space,
            shape=shape,
            settings=self.settings.hull,
            joints=replace(self.joints, weights=weights),
        )

    def _best(self, fitter: HullFitter, hull: Hull, starts: HandPose, shape: Tensor, masks: Masks) -> Placed | None:
        if hull.target is None or not len(starts):
            return None
        found = fitter(hull.target, starts)
        best = found.cost.argsort()[: self.settings.start.fine]
        return chosen([self._placed(found.select(int(index)), shape, masks) for index in best])

    def _placed(self, found: Solutions, shape: Tensor, masks: Masks) -> Placed:
        fit = HullFit.of(found)
        return Placed(fit=fit, overlaps=self._made_for(shape).comparison.overlaps(found.pose, masks))

    def _made_for(self, shape: Tensor) -> "_Made":
        """What depends on the proportions, kept while they stay the same."""
        if self._made is None or self._made.comparison.shape is not shape:
            s = self.settings
            broad = HullFitter(
                hand=self.hand, space=self.space, shape=shape, settings=s.hull, schedule=s.search, joints=self.joints
            )
            near = replace(broad, settings=replace(s.hull, vertices=s.tracking_vertices), schedule=s.tracking)
            comparison = SilhouetteComparison(self.hand.kinematics, self.cameras, shape, side_px=s.check_side_px)
            self._made = _Made(
                near=near, settling=replace(near, schedule=_SETTLING), broad=broad, comparison=comparison
            )
        return self._made


def score_of(overlap: float, covered_share: float) -> float:
    """How much of the pictures a hand explains, 0 to 1: the silhouettes' areas and their edges, in equal shares."""
    return 0.5 * (overlap + covered_share)


def _stacked(anchors: Sequence[Anchor]) -> HandPose:
    """(anchors)"""
    return HandPose(
        dofs=torch.stack([one.pose for one in anchors]), reference=torch.stack([one.root_reference for one in anchors])
    )


def chosen(tried: Sequence[Placed | None]) -> Placed | None:
    """The one that the silhouettes bear out best; among those that they bear out alike, that of the lowest cost."""
    good = [one for one in tried if one is not None and bool(one.fit.cost.isfinite())]
    if not good:
        return None
    best = max(one.score for one in good)
    return min((one for one in good if one.score >= best - _ALIKE * (1 - best)), key=lambda one: float(one.fit.cost))
