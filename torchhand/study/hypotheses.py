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

from torchhand.geometry import Camera, vector_from_rotation
from torchhand.hand import PoseConstraints, Side, named_pose_space, rebased
from torchhand.hand.model import HandModel
from torchhand.image import hand_region, intersection_over_union
from torchhand.residuals import Expectation, PostureResiduals
from torchhand.study.evaluation import MIDDLE_MCP
from torchhand.study.hypothesis_record import Hypotheses
from torchhand.study.hypothesis_settings import HypothesisStudySettings
from torchhand.study.perturbation import draw_perturbations, seed_of, spread_of_starts
from torchhand.study.pose_errors import PoseErrors, pose_errors
from torchhand.study.positions import WRIST
from torchhand.track.picture_contours import picture_contours
from torchhand.track.registration import Registration, RegistrationStatus, own_limits, register
from torchhand.view import HandProjector, outline_table
from torchhand.view.contours import Contours, PrimitiveContours
from torchhand.view.mesh_contours import MeshContours

_ROOT = 6
_SETTLED_SIZE = 0.3  # of the largest perturbation: starts among which a reference is looked for


@dataclass(frozen=True, kw_only=True)
class StudyCase:
    """A picture, and the hand in it."""

    frame: int
    image: UInt8[Tensor, "height width 3"]
    """RGB."""
    mask: Bool[Tensor, "height width"]
    """Silhouette of the hand; a forearm may be part of it."""
    camera: Camera
    side: Side
    shape: Float[Tensor, "shape"]
    pose: Float[Tensor, "36"]
    """The reference, metres and radians; float64."""
    root_reference: Float[Tensor, "3 3"]
    """world_from_hand where the rotation vector is zero."""


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
        pose, reference = rebased(case.pose.double(), case.root_reference.double())
        self.case = replace(case, pose=pose.to(device), root_reference=reference.to(device))
        self.model = replace(
            model,
            skeleton=model.skeleton.to(device=device),
            shape_space=model.shape_space.to(device=device),
        )
        self.kinematics = self.model.kinematics(case.side, dtype=torch.float64).to(device)
        self.camera = case.camera.to(dtype=torch.float64, device=device)
        self.shape = case.shape.to(self.kinematics.default_shape)
        self.space = named_pose_space(settings.space).to(device=device).about(self.case.pose)
        self.picture = picture_contours(case.mask.to(device), settings.engine, image=case.image.to(device))
        self._constraints = PoseConstraints(self.model.skeleton)
        self._prior = (prior or PostureResiduals.of(model.prior().postures)) if settings.has_prior else None
        self._std = spread_of_starts(self.space, settings.perturbation).to(device)

    @cached_property
    def contours(self) -> Contours:
        """Of the surface that is registered."""
        s = self.settings
        if s.surface == "mesh":
            hand = self.model.hand(side=self.case.side, dtype=torch.float64).to(self.device)
            return MeshContours(hand, self.camera, self.space.basis, self.shape, points=s.mesh_points)
        table = outline_table(s.points_per_generator, s.points_per_arc, without=("palm_wrist",))
        table = replace(table, **{f.name: getattr(table, f.name).to(self.device) for f in fields(table)})
        return PrimitiveContours(HandProjector(self.kinematics, self.camera, self.shape), table, self.space.basis)

    @property
    def overlap(self) -> float:
        """Intersection over union of the reference hand's silhouette and the mask, forearm cut at the wrist."""
        case, projector = self.case, HandProjector(self.kinematics, self.camera, self.shape)
        points = self.camera.project(projector.frames(case.pose, case.root_reference).keypoints)
        drawn = projector.silhouette(case.pose, case.root_reference)
        region = hand_region((self.camera.height, self.camera.width), points[WRIST], points[MIDDLE_MCP])
        return float(intersection_over_union(case.mask.to(drawn.device), drawn, region))

    def settled(self, starts: int, seed: int) -> StudyCase:
        """The case with the cheapest of some registrations about its reference in place of it.

        For pictures without truth: what was fitted in another way is put to where this registration wants it.
        """
        generator = torch.Generator().manual_seed(seed_of(seed, "reference", self.case.frame))
        size = _SETTLED_SIZE * (torch.arange(starts) > 0).double()
        pose = self._poses(draw_perturbations(self.space, size, self.settings.perturbation, generator))
        expected = Expectation.from_std(self.space.free(self.case.pose), self.case.root_reference, self._std)
        found = self._registered(pose, expected)
        best = found.select(found.best)
        if not bool(best.cost.isfinite()):
            return self.case
        return replace(self.case, pose=best.pose, root_reference=best.root_reference)

    def run(self, batch: StudyBatch, seed: int) -> Hypotheses:
        """Register one batch; the same for the same seed, whatever was done before."""
        s, own_seed = self.settings, seed_of(seed, self.case.frame, batch.first)
        generator = torch.Generator().manual_seed(own_seed)
        level = (batch.first + torch.arange(batch.count)) % s.perturbation.levels + 1
        size = level.double() / s.perturbation.levels
        change = draw_perturbations(self.space, size, s.perturbation, generator)
        lower, upper = own_limits(self.space, self.kinematics.skeleton)
        change = change.to(self.device).clamp(lower, upper)
        pose = self._poses(change)
        expected = None
        if s.has_expectation:
            reference = self.case.root_reference.expand(len(pose), 3, 3)
            expected = Expectation.from_std(change, reference, self._std)
        found = self._registered(pose, expected)
        begun = self._errors(pose, self.case.root_reference.expand(len(pose), 3, 3))
        ended = self._errors(found.pose, found.root_reference)
        failed = found.status > RegistrationStatus.STALLED.value
        whole = torch.cat((found.pose[:, :3], vector_from_rotation(found.root_reference), found.pose[:, _ROOT:]), -1)

        def known(values: Tensor) -> np.ndarray:
            shaped = failed.reshape(-1, *(1,) * (values.ndim - 1))
            return torch.where(shaped, torch.nan, values).cpu().numpy()

        return Hypotheses(
            frame=np.full(batch.count, self.case.frame),
            batch=np.full(batch.count, batch.index),
            seed=np.full(batch.count, own_seed),
            level=level.numpy(),
            perturbation=change.cpu().numpy(),
            start_angle_deg=begun.angle_deg.cpu().numpy(),
            start_keypoint_mm=begun.keypoint_mm.cpu().numpy(),
            start_rotation_deg=begun.rotation_deg.cpu().numpy(),
            angle_deg=known(ended.angle_deg),
            keypoint_mm=known(ended.keypoint_mm),
            rotation_deg=known(ended.rotation_deg),
            contour_px=known(found.contour_px),
            cost=torch.where(failed, torch.inf, found.cost).cpu().numpy(),
            status=found.status.cpu().numpy(),
            iterations=found.iterations.cpu().numpy(),
            pose=known(whole),
        )

    def _poses(self, change: Tensor) -> Float[Tensor, "starts 36"]:
        return self.space.dof(change.to(self.device))

    def _errors(self, pose: Tensor, reference: Tensor) -> PoseErrors:
        case, joints = self.case, self.space.basis[_ROOT:].any(-1)
        return pose_errors(self.kinematics, self.shape, pose, reference, case.pose, case.root_reference, joints)

    def _registered(self, pose: Float[Tensor, "starts 36"], expected: Expectation | None) -> Registration:
        return register(
            self.picture,
            self.contours,
            self.space,
            pose,
            self.case.root_reference,
            self.settings.engine,
            constraints=self._constraints,
            prior=self._prior,
            expected=expected,
        )
