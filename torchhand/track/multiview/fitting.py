"""Hands fitted to the silhouettes of one moment: from a prediction, from hands of other moments, or without a guess."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.fit import Expectation, PostureResiduals
from torchhand.fit.hull import HullFit, HullFitter, HullLevel, find_in_hull, fit_by_torques, palm_of, varied_digits
from torchhand.geometry import Camera, rotation_from_vector
from torchhand.hand import ConstraintSettings, Hand, HandPrior, PoseConstraints, named_pose_space
from torchhand.track.multiview.agreement import ViewAgreement, mean_overlap, score_of
from torchhand.track.multiview.hulls import Hull, Hulls
from torchhand.track.multiview.settings import MultiViewSettings
from torchhand.track.scene import Masks

_KNUCKLE = 9  # keypoint about which the hull is carved: the middle finger's
_SETTLING = (
    HullLevel(robust_m=0.012, rounds=2, iterations=2),
    HullLevel(robust_m=0.005, rounds=2, iterations=2),
    HullLevel(robust_m=0.002, rounds=1, iterations=3),
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
        return score_of(self.overlap, float(self.fit.covered_share))

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
    agreement: ViewAgreement


class MomentFitter:
    """Everything that fits one hand to the silhouettes of one moment, for a fixed rig."""

    def __init__(self, hand: Hand, cameras: Sequence[Camera], settings: MultiViewSettings) -> None:
        """hand: in float64. cameras: without distortion.

        Raises ValueError for cameras that see no volume together where no cube is given.
        """
        self.hand, self.settings = hand, settings
        self.cameras = tuple(camera.to(dtype=torch.float64) for camera in cameras)
        self.hulls = Hulls(
            self.cameras, settings.octree, fewest_views=settings.loss.fewest_views, contours=settings.contours
        )
        self.space = named_pose_space(settings.pose_space)
        skeleton = hand.kinematics.skeleton
        self.beliefs: dict[str, Any] = {
            # One finger bent beside straight ones is told by the silhouettes; equation (3) would forbid it.
            "constraints": PoseConstraints(skeleton, ConstraintSettings(bands="none")),
            "prior": PostureResiduals.of(HandPrior(skeleton, hand.kinematics.shape_space).postures),
        }
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
        track = self._made_for(shape).near
        if self.settings.fitting == "torque":
            settings, pose, reference = self.settings.torque, starts[0].pose[None], starts[0].root_reference[None]
            found = fit_by_torques(hull.target.field, self.hand, self.space, pose, reference, settings, shape=shape)
            judged = track(hull.target, found.pose, found.root_reference)  # how sure it is, and how good
            fit = replace(judged, pose=found.pose, root_reference=found.root_reference)
        else:
            expectation = Expectation.from_covariance(mean[None], starts[0].root_reference[None], covariance[None])
            fit = track(hull.target, *_stacked(starts), expected=expectation)
        return self._placed(fit.select(fit.best), shape, masks)

    def from_anchors(
        self, hull: Hull, anchors: Sequence[Anchor], shape: Float[Tensor, "shape"], masks: Masks
    ) -> Placed | None:
        """The best of the hands fitted from some that may be a good way off; None without a hull or an anchor."""
        return self._best(self._made_for(shape).broad, hull, anchors, shape, masks)

    def settled(self, hull: Hull, anchor: Anchor, shape: Float[Tensor, "shape"], masks: Masks) -> Placed | None:
        """The hand fitted from one that is nearly right, the better of small steps, after which digits stay where they
        are, and large ones."""
        made = self._made_for(shape)
        return chosen([self._best(own, hull, [anchor], shape, masks) for own in (made.settling, made.broad)])

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
        found = self._made_for(shape).broad(hull.target, *_stacked([anchor, *moved]))
        whole = found.cost.isfinite().nonzero()[:, 0].tolist()
        return [self._placed(found.select(index), shape, masks) for index in whole]

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
        postures = [torch.cat((anchor.pose[:6], other.pose[6:])) for other in others]
        poses = [*varied_digits(anchor.pose), *postures]
        tried = [Anchor(pose=pose, root_reference=anchor.root_reference) for pose in poses]
        made = self._made_for(shape)
        found = made.near(hull.target, *_stacked(tried))
        cheapest = found.rows(found.cost.argsort()[: self.settings.start.fine])
        tried = [
            Anchor(pose=pose, root_reference=reference)
            for pose, reference in zip(cheapest.pose, cheapest.root_reference, strict=True)
        ]
        return self._best(made.settling, hull, tried, shape, masks)

    def turned(self, hull: Hull, anchor: Anchor, shape: Float[Tensor, "shape"], masks: Masks) -> Placed | None:
        """The best of the hands turned about the palm from where one is, such as after a fast turn of the forearm."""
        palm = self._palm(anchor, shape)
        turns = torch.deg2rad(torch.tensor(_TURNS, dtype=anchor.pose.dtype))
        references = rotation_from_vector(turns @ anchor.root_reference.mT) @ anchor.root_reference
        moved = palm + references @ (anchor.root_reference.mT @ (anchor.pose[:3] - palm))
        tried = [
            Anchor(pose=torch.cat((place, anchor.pose[3:])), root_reference=reference)
            for place, reference in zip(moved, references, strict=True)
        ]
        return self._best(self._made_for(shape).settling, hull, tried, shape, masks)

    def searched(self, hull: Hull, shape: Float[Tensor, "shape"], masks: Masks) -> Placed | None:
        """The best of a search without any guess; None where nothing can be looked for."""
        if hull.target is None:
            return None
        start, fit = self.settings.start, self.settings.start_fit
        found = find_in_hull(hull.target, self.hand, self.space, shape[None], start, fit, **self.beliefs)
        return chosen([self._placed(one.fit, shape, masks) for one in found])

    def _best(
        self, fitter: HullFitter, hull: Hull, anchors: Sequence[Anchor], shape: Tensor, masks: Masks
    ) -> Placed | None:
        if hull.target is None or not anchors:
            return None
        found = fitter(hull.target, *_stacked(anchors))
        best = found.cost.argsort()[: self.settings.start.fine]
        return chosen([self._placed(found.select(int(index)), shape, masks) for index in best])

    def _placed(self, fit: HullFit, shape: Tensor, masks: Masks) -> Placed:
        return Placed(fit=fit, overlaps=self._made_for(shape).agreement(fit.pose, fit.root_reference, masks))

    def _made_for(self, shape: Tensor) -> "_Made":
        """What depends on the proportions, kept while they stay the same."""
        if self._made is None or self._made.agreement.shape is not shape:
            s = self.settings
            near, settling, broad = (
                HullFitter(self.hand, self.space, own, shape=shape, **self.beliefs)
                for own in (s.fit, replace(s.fit, levels=_SETTLING), s.start_fit)
            )
            agreement = ViewAgreement(self.hand.kinematics, self.cameras, shape, side_px=s.check_side_px)
            self._made = _Made(near=near, settling=settling, broad=broad, agreement=agreement)
        return self._made


def _stacked(anchors: Sequence[Anchor]) -> tuple[Float[Tensor, "n 36"], Float[Tensor, "n 3 3"]]:
    """Poses and references."""
    return torch.stack([one.pose for one in anchors]), torch.stack([one.root_reference for one in anchors])


def chosen(tried: Sequence[Placed | None]) -> Placed | None:
    """The one that the silhouettes bear out best; among those that they bear out alike, that of the lowest cost."""
    good = [one for one in tried if one is not None and bool(one.fit.cost.isfinite())]
    if not good:
        return None
    best = max(one.score for one in good)
    return min((one for one in good if one.score >= best - _ALIKE * (1 - best)), key=lambda one: float(one.fit.cost))
