"""Hands fitted to the silhouettes of one frame: from a prediction, from hands of other frames, or without a guess."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.fit import GaussianPrior, PostureResiduals, SharedSolution, Solutions, SolveStatus, Stage
from torchhand.fit.hull import (
    SEARCH,
    TRACKING,
    HullEvidence,
    HullFitter,
    HullTarget,
    JointPriors,
    find_in_hull,
    finger_proposals,
    fit_by_torques,
    fit_proposals,
    fit_shape,
    palm_of,
)
from torchhand.geometry import Camera, rotation_from_vector
from torchhand.hand import (
    Anthropometry,
    ConstraintSettings,
    Hand,
    HandPose,
    HandPrior,
    PoseConstraints,
    named_pose_space,
)
from torchhand.track.multiview.hulls import Hull, Hulls
from torchhand.track.multiview.settings import RigSettings
from torchhand.track.scene import Masks, PlacedHand, SilhouetteComparison, mean_overlap

_KNUCKLE = 9  # keypoint about which the hull is carved: the middle finger's
_REFINING = (
    Stage(gross_m=0.012, rounds=2, iterations=2),
    Stage(gross_m=0.005, rounds=2, iterations=2),
    Stage(gross_m=0.002, rounds=1, iterations=3),
)
_TRYING = (
    Stage(gross_m=0.006, rounds=1, iterations=1, method="gauss_newton"),
    Stage(gross_m=0.002, rounds=1, iterations=1, method="gauss_newton"),
)
"""For hands of which the cheapest are refined: a step each, whether they have arrived or not."""
_TURNS_DEG = (
    *((0.0, angle, 0.0) for angle in (-90.0, -60.0, -30.0, 30.0, 60.0, 90.0)),
    *((angle, 0.0, 0.0) for angle in (-30.0, 30.0)),
    *((0.0, 0.0, angle) for angle in (-25.0, 25.0)),
)
"""Rotation vectors about the hand's axes, degrees: mostly about that of the forearm."""
_REFINED, _REFINED_TURNS = 8, 3  # hands that are fitted to all data, of those that were compared with some of them
_FEW_RAYS = 200
_CHECK_SIDE_PX = 160  # of the reduced pictures in which silhouettes are compared
_POSTURES_FOR_SHAPE = 0.8
"""Weight of the posture prior in the fit of the proportions: the less each frame's posture may deviate, the more the
frames tell of the proportions."""
_BENT = 0.1  # radians in any joint, from which on another posture was found
_ALIKE = 0.25  # part of what the best fit leaves unexplained: scores that differ by less are alike, the cost decides


@dataclass(frozen=True, kw_only=True)
class HullFit:
    """One hand fitted into the hull of one frame, and how the silhouettes bear it out."""

    pose: HandPose
    """Pose with a zero rotation vector, world frame."""
    cost: Float[Tensor, ""]
    """Cost of the fit, nats; infinite if the fit failed."""
    covariance: Float[Tensor, "free free"]
    """Covariance of the free parameters, the rotation as a left perturbation of the reference; NaN if the fit
    failed."""
    inside_fraction: float
    """Fraction of the skin inside the hull (the rate of convergence of Ueda et al. 2003)."""
    covered_fraction: float
    """Fraction of the silhouettes' edges that the skin explains."""
    is_good: bool
    """Whether the fit is good enough for a hand and not for something else."""
    overlaps: Float[Tensor, "views"]
    """Intersection over union in every view, NaN where one is missing."""
    placed: PlacedHand | None = None
    """The hand before the cameras; None where that was not computed."""

    @classmethod
    def of(cls, found: Solutions, overlaps: Float[Tensor, "views"], placed: PlacedHand) -> "HullFit":
        """The fit of one hypothesis, without batch dimensions."""
        evidence = HullEvidence.of(found)
        return cls(
            pose=found.pose,
            cost=found.cost,
            covariance=found.covariance,
            inside_fraction=float(evidence.inside),
            covered_fraction=float(evidence.covered),
            is_good=bool(evidence.is_good),
            overlaps=overlaps,
            placed=placed,
        )

    def refitted(self, solution: SharedSolution, row: int, overlaps: Float[Tensor, "views"]) -> "HullFit":
        """The fit of the same frame as one of several with one shape; its cost stays that of the frame by itself."""
        is_sound = solution.frame_status != SolveStatus.FAILED.value
        evidence = HullEvidence.told_by(solution.explained, is_sound)
        return replace(
            self,
            pose=solution.pose[row],
            covariance=solution.covariance[row],
            inside_fraction=float(evidence.inside[row]),
            covered_fraction=float(evidence.covered[row]),
            is_good=bool(evidence.is_good[row]),
            overlaps=overlaps,
            placed=None,
        )

    @property
    def overlap(self) -> float:
        """Mean intersection over union of the views."""
        return mean_overlap(self.overlaps)

    @property
    def score(self) -> float:
        """How much of the pictures the hand explains, 0 to 1: the silhouettes' areas and their edges, in equal
        parts."""
        return 0.5 * (self.overlap + self.covered_fraction)


@dataclass(frozen=True, kw_only=True)
class _Fitters:
    """What fits a hand of some proportions."""

    tracking: HullFitter
    """Fitter from a prediction, or from a pose that differs by one digit."""
    trying: HullFitter
    """Fitter that compares many hands with some of the data."""
    refining: HullFitter
    """Fitter from a pose that may be 10 mm off."""
    searching: HullFitter
    """Fitter from starts that may be farther off."""
    comparison: SilhouetteComparison


class FrameFitter:
    """Everything that fits one hand to the silhouettes of one frame, for a fixed rig."""

    def __init__(self, hand: Hand, cameras: Sequence[Camera], settings: RigSettings) -> None:
        """hand: in float64. cameras: without distortion.

        Raises ValueError for cameras that see no volume together where no cube is given.
        """
        self.hand, self.settings = hand, settings
        self.cameras = tuple(camera.to(dtype=torch.float64, device=hand.shape.device) for camera in cameras)
        self.hulls = Hulls(self.cameras, settings.octree, min_views=settings.min_views)
        device, skeleton = hand.shape.device, hand.kinematics.skeleton
        self.space = named_pose_space(settings.pose_space).to(device=device)
        self.joints = JointPriors(
            # One finger bent beside straight ones is told by the silhouettes; the bands between the knuckles' flexions
            # (Ouhaddi and Horain 1998, eq. 3) would forbid it.
            constraints=PoseConstraints(skeleton, ConstraintSettings(bands="none")),
            postures=PostureResiduals.of(HandPrior(skeleton, hand.kinematics.shape_space).to(device).postures),
            weights=settings.joints,
        )
        self._fitters: _Fitters | None = None

    def hull_about(self, pose: HandPose, shape: Float[Tensor, "shape"], masks: Masks) -> Hull:
        """The hull where a hand is, or is expected."""
        return self.hulls.near(masks, self.place_of(pose, shape))

    def place_of(self, pose: HandPose, shape: Float[Tensor, "shape"]) -> Float[Tensor, "3"]:
        """The knuckle about which the hull of a hand is carved."""
        return self.hand.kinematics(pose.dofs, shape, root_reference=pose.reference).keypoints[_KNUCKLE]

    def hull_anywhere(self, shape: Float[Tensor, "shape"] | None, masks: Masks) -> Hull:
        """What may be the hand in all that the silhouettes show, arm included; for a shape, or the generic hand's."""
        space = self.hand.kinematics.shape_space
        known = self.hand.kinematics.default_shape if shape is None else shape
        return self.hulls.anywhere(masks, hand_length=float(space.metric(known)["hand_length"]))

    def fit_predicted(
        self,
        hull: Hull,
        starts: Sequence[HandPose],
        mean: Float[Tensor, "free"],
        covariance: Float[Tensor, "free free"],
        shape: Float[Tensor, "shape"],
        masks: Masks,
    ) -> HullFit | None:
        """The hand fitted with a prediction, the best of some starts; None without a hull.

        starts: the first is the prediction itself. mean, covariance: of the prediction in the free parameters, about
        the root reference of the first start.
        """
        if hull.target is None:
            return None
        fitter = self._fitters_for(shape).tracking
        if self.settings.fitting == "torque":
            start = HandPose.stack(starts[:1])
            pulled = fit_by_torques(hull.target.field, fitter.vertices.skin, self.space, start, self.settings.torque)
            evaluated = fitter(hull.target, pulled.pose)  # for its covariance and its evidence
            found = replace(evaluated, pose=pulled.pose)
        else:
            prediction = HandPose.of(self.space.dof(mean), starts[0].reference)
            belief = GaussianPrior.of_covariance(prediction, covariance, self.space)
            found = fitter(hull.target, HandPose.stack(starts), belief)
        return self._compared(found.select(found.best), shape, masks)

    def fit_from(
        self, hull: Hull, starts: Sequence[HandPose], shape: Float[Tensor, "shape"], masks: Masks
    ) -> HullFit | None:
        """The best of the hands fitted from some that may be a good way off; None without a hull or a start."""
        if not starts:
            return None
        return self._best(self._fitters_for(shape).searching, hull, HandPose.stack(starts), shape, masks)

    def refine(
        self,
        hull: Hull,
        start: HandPose,
        shape: Float[Tensor, "shape"],
        masks: Masks,
        *,
        is_enough: Callable[[HullFit], bool] = lambda fit: False,
    ) -> HullFit | None:
        """The hand fitted from one that is nearly right: the better of small steps, after which digits stay where they
        are, and large ones, which take most of the time.

        is_enough: whether what small steps led to needs no large ones.
        """
        fitters, starts = self._fitters_for(shape), HandPose.stack([start])
        near = self._best(fitters.refining, hull, starts, shape, masks)
        if near is not None and is_enough(near):
            return near
        return best_of([near, self._best(fitters.searching, hull, starts, shape, masks)])

    def fit_in_place(
        self, hull: Hull, pose: HandPose, others: Sequence[HandPose], shape: Float[Tensor, "shape"], masks: Masks
    ) -> list[HullFit]:
        """Hands fitted from one, and from where others would be if their palms were where its palm is."""
        if hull.target is None:
            return []
        palm = self._palm(pose, shape)
        moved = [
            replace(other, dofs=torch.cat((other.dofs[:3] + palm - self._palm(other, shape), other.dofs[3:])))
            for other in others
        ]
        found = self._fitters_for(shape).searching(hull.target, HandPose.stack([pose, *moved]))
        return [self._compared(found.select(index), shape, masks) for index in found.is_sound.nonzero()[:, 0].tolist()]

    def vary_fingers(
        self, hull: Hull, pose: HandPose, others: Sequence[HandPose], shape: Float[Tensor, "shape"], masks: Masks
    ) -> HullFit | None:
        """The best of the hands in one place, with single digits in other postures or in the postures of others; the
        cheapest after small steps are refined. Twice: a digit may have to move before another has room."""
        first = self._varied(hull, pose, others, shape, masks)
        if first is None or not _is_bent_otherwise(first.pose, pose):
            return first
        return best_of([first, self._varied(hull, first.pose, [], shape, masks)])

    def _varied(
        self, hull: Hull, pose: HandPose, others: Sequence[HandPose], shape: Tensor, masks: Masks
    ) -> HullFit | None:
        if hull.target is None:
            return None
        postures = [torch.cat((pose.dofs[:6], other.dofs[6:])) for other in others]
        tried = HandPose.of(torch.stack([*finger_proposals(pose).dofs, *postures]), pose.reference)
        fitters = self._fitters_for(shape)
        found = fitters.trying(_with_few_rays(hull.target), tried)
        cheapest = found.pose[found.cost.argsort()[:_REFINED]]
        return self._best(fitters.refining, hull, cheapest, shape, masks)

    def vary_orientation(
        self, hull: Hull, pose: HandPose, shape: Float[Tensor, "shape"], masks: Masks
    ) -> HullFit | None:
        """The best of the hands turned about the palm from where one is, such as after a fast turn of the forearm."""
        palm = self._palm(pose, shape)
        turns = torch.deg2rad(pose.dofs.new_tensor(_TURNS_DEG))
        references = rotation_from_vector(turns @ pose.reference.mT) @ pose.reference
        moved = palm + references @ (pose.reference.mT @ (pose.dofs[:3] - palm))
        tried = HandPose.of(torch.cat((moved, pose.dofs[3:].expand(len(moved), -1)), -1), references)
        if hull.target is None:
            return None
        fitters = self._fitters_for(shape)
        found = replace(fitters.trying, schedule=_REFINING)(_with_few_rays(hull.target), tried)
        cheapest = found.pose[found.cost.argsort()[:_REFINED_TURNS]]
        return self._best(fitters.tracking, hull, cheapest, shape, masks)

    def fit_proposed(
        self,
        hull: Hull,
        proposals: HandPose | None,
        shape: Float[Tensor, "shape"],
        masks: Masks,
        *,
        tries_fingers: bool = True,
    ) -> HullFit | None:
        """The best of some proposed hands (n,), which may be a good way off; None without a hull or a proposal.

        tries_fingers: in other postures too; not needed where keypoints told these.
        """
        if hull.target is None or hull.target.is_empty or proposals is None or not len(proposals):
            return None
        fitter, settings = self._fitters_for(shape).searching, self.settings.start
        if not tries_fingers:
            settings = replace(settings, proposed_finger_rounds=0)
        return self._compared(fit_proposals(hull.target, fitter, proposals, shape, settings), shape, masks)

    def turn_over(self, hull: Hull, pose: HandPose, shape: Float[Tensor, "shape"], masks: Masks) -> HullFit | None:
        """The hand fitted from one that shows its back where a hand shows its palm, in the same place; two views tell
        both hardly apart before the fingers are fitted."""
        palm, over = self._palm(pose, shape), torch.diag(pose.dofs.new_tensor((-1.0, 1.0, -1.0)))
        moved = palm + pose.reference @ over @ pose.reference.mT @ (pose.dofs[:3] - palm)
        turned = HandPose.of(torch.cat((moved, pose.dofs[3:])), pose.reference @ over)
        return self.fit_proposed(hull, HandPose.stack([turned]), shape, masks)

    def search(
        self, hull: Hull, shape: Float[Tensor, "shape"], masks: Masks, *, is_quick: bool = False
    ) -> HullFit | None:
        """The best of a search without any guess; None where nothing can be looked for. is_quick: with half the
        hypotheses, in a third of the time."""
        if hull.target is None:
            return None
        settings = self.settings.start
        found = find_in_hull(
            hull.target,
            self._fitters_for(shape).searching,
            shape[None],
            settings.reduced() if is_quick else settings,
        )
        return best_of([self._compared(one.found, shape, masks) for one in found])

    def fit_shape(
        self, hulls: Sequence[Hull], starts: HandPose, shape: Float[Tensor, "shape"], *, is_rough: bool
    ) -> SharedSolution:
        """Proportions and poses fitted to the hulls of several frames, none empty, from some proportions.

        is_rough: with half the rounds, where more will follow.
        """
        weights = replace(self.settings.joints, postures=_POSTURES_FOR_SHAPE, penetration=0.0)
        fitter = HullFitter(
            hand=self.hand,
            space=self.space,
            shape=shape,
            settings=self.settings.hull,
            joints=replace(self.joints, weights=weights),
        )
        settings = self.settings.shape
        if is_rough:
            settings = replace(settings, rounds=max(1, settings.rounds // 2))
        targets = [hull.target for hull in hulls if hull.target is not None]
        return fit_shape(fitter, targets, starts, Anthropometry(self.hand.kinematics.shape_space), settings)

    def overlaps(self, pose: HandPose, shape: Float[Tensor, "shape"], masks: Masks) -> Float[Tensor, "views"]:
        """Intersection over union of a hand () and the silhouettes, view by view; NaN where one is missing."""
        return self._fitters_for(shape).comparison.overlaps(pose, masks)

    def _palm(self, pose: HandPose, shape: Tensor) -> Float[Tensor, "3"]:
        return palm_of(self.hand.kinematics(pose.dofs, shape, root_reference=pose.reference).keypoints)

    def _best(self, fitter: HullFitter, hull: Hull, starts: HandPose, shape: Tensor, masks: Masks) -> HullFit | None:
        if hull.target is None or not len(starts):
            return None
        found = fitter(hull.target, starts)
        best = found.cost.argsort()[: self.settings.start.fine]
        return best_of([self._compared(found.select(int(index)), shape, masks) for index in best])

    def _compared(self, found: Solutions, shape: Tensor, masks: Masks) -> HullFit:
        comparison = self._fitters_for(shape).comparison
        placed = comparison.placed(found.pose)
        return HullFit.of(found, comparison.overlaps(placed, masks), placed)

    def _fitters_for(self, shape: Tensor) -> _Fitters:
        """What depends on the proportions, kept while they stay the same."""
        if self._fitters is None or self._fitters.comparison.shape is not shape:
            s = self.settings
            searching = HullFitter(
                hand=self.hand, space=self.space, shape=shape, settings=s.hull, schedule=SEARCH, joints=self.joints
            )
            tracking = replace(searching, settings=replace(s.hull, vertices=s.tracking_vertices), schedule=TRACKING)
            comparison = SilhouetteComparison(self.hand.kinematics, self.cameras, shape, side_px=_CHECK_SIDE_PX)
            self._fitters = _Fitters(
                tracking=tracking,
                trying=replace(
                    tracking, settings=replace(tracking.settings, vertices=s.start.vertices), schedule=_TRYING
                ),
                refining=replace(tracking, schedule=_REFINING),
                searching=searching,
                comparison=comparison,
            )
        return self._fitters


def _with_few_rays(target: HullTarget) -> HullTarget:
    return target if target.rays is None else replace(target, rays=target.rays.thinned(_FEW_RAYS))


def _is_bent_otherwise(one: HandPose, other: HandPose) -> bool:
    return float((one.dofs[6:] - other.dofs[6:]).abs().max()) > _BENT


def best_of(fits: Sequence[HullFit | None]) -> HullFit | None:
    """The fit that the silhouettes bear out best; among those that they bear out alike, that of the lowest cost."""
    good = [fit for fit in fits if fit is not None and bool(fit.cost.isfinite())]
    if not good:
        return None
    best = max(fit.score for fit in good)
    return min((fit for fit in good if fit.score >= best - _ALIKE * (1 - best)), key=lambda fit: float(fit.cost))
