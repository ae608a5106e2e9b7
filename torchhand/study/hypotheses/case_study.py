"""The hypothesis study: thousands of perturbed starts registered on pictures whose hand is known, batch by batch.

Every batch has a generator of its own, so that batches can be done in any order, side by side, or some another day, and
come out the same.
"""

from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from torchhand.evaluate import MIDDLE_MCP, WRIST, PoseErrors, pose_errors
from torchhand.fit import (
    ConstraintPrior,
    GaussianPrior,
    PosturePrior,
    PostureResiduals,
    Problem,
    Solutions,
    SolveStatus,
    free_bounds,
)
from torchhand.fit.contour import WIDE_SEARCH, ContourObservation, Restarts, picture_contours, solve_with_restarts
from torchhand.geometry import Camera
from torchhand.hand import HandModel, HandPose, PoseConstraints, Side, named_pose_space
from torchhand.image import hand_region, intersection_over_union
from torchhand.study import draw_perturbations, seed_of, spread_of_starts
from torchhand.study.hypotheses.record import Hypotheses
from torchhand.study.hypotheses.settings import HypothesisStudySettings
from torchhand.view import Contours, HandProjector, MeshContours, PrimitiveContours, outline_table

_ROOT = 6
_AT_ONCE = 256  # starts that are solved together, and stay near the processor; restarts are those of a whole batch
_REFINEMENT_SIZE = 0.3  # of the largest perturbation: starts among which a reference is looked for


@dataclass(frozen=True, kw_only=True)
class StudyCase:
    """A picture, and the hand in it."""

    frame: int
    image: UInt8[Tensor, "height width 3"]
    """The picture, RGB."""
    mask: Bool[Tensor, "height width"]
    """Silhouette of the hand; a forearm may be part of it."""
    camera: Camera
    side: Side
    shape: Float[Tensor, "shape"]
    pose: HandPose
    """Reference pose, () float64: starts are perturbed from it, and errors are against it."""


@dataclass(frozen=True, kw_only=True)
class StudyBatch:
    """Starts that are registered together."""

    index: int
    case: int
    first: int
    """Number of its first start among the case's."""
    count: int


def plan_batches(settings: HypothesisStudySettings, cases: int) -> list[StudyBatch]:
    """The starts shared out over the cases, the first ones having one more where they must, and cut into batches."""
    if not 1 <= cases <= settings.starts:
        raise ValueError(f"cases: expected 1 to {settings.starts}, one start each, got {cases}")
    plan = []
    for case in range(cases):
        count = settings.starts // cases + (case < settings.starts % cases)
        for first in range(0, count, settings.batch):
            size = min(settings.batch, count - first)
            plan.append(StudyBatch(index=len(plan), case=case, first=first, count=size))
    return plan


class CaseStudy:
    """One case with all that its registrations share; computes on the device it is given."""

    def __init__(
        self,
        case: StudyCase,
        model: HandModel,
        settings: HypothesisStudySettings,
        prior: PostureResiduals | None = None,
        device: torch.device | str = "cpu",
    ) -> None:
        """prior: of the model's postures, for settings that have one; made here if not given, which takes a while."""
        self.settings, self.device = settings, torch.device(device)
        exact = torch.zeros((), dtype=torch.float64, device=device)
        self.case = replace(case, pose=case.pose.to(exact).normalized())
        self.model = replace(
            model,
            skeleton=model.skeleton.to(device=device),
            shape_space=model.shape_space.to(device=device),
        )
        self.kinematics = self.model.kinematics(case.side, dtype=torch.float64).to(device)
        self.camera = case.camera.to(dtype=torch.float64, device=device)
        self.shape = case.shape.to(self.kinematics.default_shape)
        self.space = named_pose_space(settings.space).to(device=device).about(self.case.pose.dofs)
        schedule = (*WIDE_SEARCH, *settings.schedule)
        self.picture = picture_contours(case.mask.to(device), schedule, settings.contour, image=case.image.to(device))
        self._dtype = torch.float32 if settings.precision == "single" else torch.float64
        self._constraints = PoseConstraints(self.model.skeleton)
        self._postures = (prior or PostureResiduals.of(model.prior().postures)) if settings.has_prior else None
        self._std = spread_of_starts(self.space, settings.perturbation).to(device)

    @cached_property
    def contours(self) -> Contours:
        """Contours of the surface that is registered."""
        s, camera, shape = self.settings, self.camera.to(dtype=self._dtype), self.shape.to(self._dtype)
        if s.surface == "mesh":
            hand = self.model.hand(side=self.case.side, dtype=self._dtype).to(self.device)
            return MeshContours(hand, camera, shape, max_points=s.mesh_points)
        table = outline_table(s.points_per_generator, s.points_per_arc, without=("palm_wrist",))
        table = replace(table, **{f.name: getattr(table, f.name).to(self.device) for f in fields(table)})
        kinematics = self.model.kinematics(self.case.side, dtype=self._dtype).to(self.device)
        return PrimitiveContours(HandProjector(kinematics, camera, shape), table)

    @property
    def overlap(self) -> float:
        """Intersection over union of the reference hand's silhouette and the mask, forearm cut at the wrist."""
        case, projector = self.case, HandProjector(self.kinematics, self.camera, self.shape)
        hand = case.pose
        points = self.camera.project(projector.frames(hand.dofs, hand.reference).keypoints)
        drawn = projector.silhouette(hand.dofs, hand.reference)
        region = hand_region((self.camera.height, self.camera.width), points[WRIST], points[MIDDLE_MCP])
        return float(intersection_over_union(case.mask.to(drawn.device), drawn, region))

    def refined(self, starts: int, seed: int) -> StudyCase:
        """The case with the cheapest of some registrations about its reference in place of it.

        For pictures without truth: what was fitted in another way is put to where this registration wants it.
        """
        generator = torch.Generator().manual_seed(seed_of(seed, "reference", self.case.frame))
        size = _REFINEMENT_SIZE * (torch.arange(starts) > 0).double()
        change = draw_perturbations(self.space, size, self.settings.perturbation, generator).to(self.device)
        found = self._registered(self._hands(change), self.case.pose)
        best = found.select(found.best)
        return replace(self.case, pose=best.pose) if bool(best.cost.isfinite()) else self.case

    def run(self, batch: StudyBatch, seed: int) -> Hypotheses:
        """Register one batch; the same for the same seed, whatever was done before."""
        s, own_seed = self.settings, seed_of(seed, self.case.frame, batch.first)
        generator = torch.Generator().manual_seed(own_seed)
        level = (batch.first + torch.arange(batch.count)) % s.perturbation.levels + 1
        size = level.double() / s.perturbation.levels
        change = draw_perturbations(self.space, size, s.perturbation, generator)
        change = change.to(self.device).clamp(*free_bounds(self.space, self.kinematics.skeleton))
        starts = self._hands(change)
        found = self._registered(starts, starts if s.has_start_prior else None)
        return self._recorded(batch, own_seed, level, change, found)

    def _recorded(
        self, batch: StudyBatch, seed: int, level: Tensor, change: Float[Tensor, "starts free"], found: Solutions
    ) -> Hypotheses:
        """A row of the record for every start."""
        begun, ended = self._errors(self._hands(change)), self._errors(found.pose)
        failed = found.status > SolveStatus.STALLED.value
        contour_px = found.explained_by("contour").distance if found.explained else found.cost

        def known(values: Tensor) -> np.ndarray:
            shaped = failed.reshape(-1, *(1,) * (values.ndim - 1))
            return torch.where(shaped, torch.nan, values).cpu().numpy()

        return Hypotheses(
            frame=np.full(batch.count, self.case.frame),
            batch=np.full(batch.count, batch.index),
            seed=np.full(batch.count, seed),
            level=level.numpy(),
            perturbation=change.cpu().numpy(),
            start_angle_deg=begun.angle_deg.cpu().numpy(),
            start_keypoint_mm=begun.keypoint_mm.cpu().numpy(),
            start_rotation_deg=begun.rotation_deg.cpu().numpy(),
            angle_deg=known(ended.angle_deg),
            keypoint_mm=known(ended.keypoint_mm),
            rotation_deg=known(ended.rotation_deg),
            contour_px=known(contour_px),
            cost=torch.where(failed, torch.inf, found.cost).cpu().numpy(),
            misfit=torch.where(failed, torch.inf, found.misfit).cpu().numpy(),
            status=found.status.cpu().numpy(),
            iterations=found.iterations.cpu().numpy(),
            pose=known(found.pose.vector),
        )

    def _hands(self, change: Float[Tensor, "starts free"]) -> HandPose:
        return HandPose.of(self.space.dof(change), self.case.pose.reference)

    def _errors(self, hands: HandPose) -> PoseErrors:
        truth, joints = self.case.pose, self.space.basis[_ROOT:].any(-1)
        return pose_errors(
            self.kinematics, self.shape, hands.dofs, hands.reference, truth.dofs, truth.reference, joints
        )

    def _registered(self, starts: HandPose, expected: HandPose | None) -> Solutions:
        """expected: one hand for all starts, or one for each."""
        belief = None if expected is None else GaussianPrior.of_std(expected, self._std, self.space)
        observation = ContourObservation(picture=self.picture, contours=self.contours, settings=self.settings.contour)
        problem = Problem(
            space=self.space.to(dtype=self._dtype),
            skeleton=self.model.skeleton,
            shape=self.contours.shape,
            observations=(observation,),
            priors=study_priors(self._constraints, self._postures, belief),
        )
        s = self.settings
        restarts = Restarts(settings=s.restarts, camera=self.contours.camera, postures=self._postures)
        found = solve_with_restarts(problem, starts, s.schedule, restarts, at_once=min(s.batch, _AT_ONCE))
        return replace(found, pose=found.pose.to(self.case.pose.dofs))


def study_priors(
    constraints: PoseConstraints, postures: PostureResiduals | None, belief: GaussianPrior | None
) -> tuple[ConstraintPrior | PosturePrior | GaussianPrior, ...]:
    """What a study's registrations know beside the picture; the postures, where given, hold the ties of joints."""
    known = (
        ConstraintPrior(constraints=constraints, has_ties=postures is None),
        None if postures is None else PosturePrior(postures=postures, is_normalized=True),
        belief,
    )
    return tuple(one for one in known if one is not None)
