"""The trials of one cell on one picture: starts, registration, errors."""

from functools import lru_cache
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.devices import HOST, read_back, sent_to
from torchhand.evaluate import PoseErrors, pose_errors
from torchhand.files import load_hand_model
from torchhand.fit import (
    GaussianPrior,
    Observation,
    PostureResiduals,
    Problem,
    Solutions,
    SolveStatus,
    free_bounds,
    solve,
)
from torchhand.fit.contour import SEARCH, ContourObservation, ContourSettings, picture_contours
from torchhand.fit.keypoints import KeypointSettings, PictureKeypoints
from torchhand.hand import HandPose, PoseConstraints, PoseSpace, named_pose_space
from torchhand.study import seed_of
from torchhand.study.designed.scene import SIDE, RenderedHand, SeenHand, SeenView, rendered_hand, seen_hand
from torchhand.study.designed.study import Study
from torchhand.study.designed.trial import Trial
from torchhand.study.hypotheses import Hypotheses, StudyBatch, study_priors
from torchhand.view import HandProjector, PrimitiveContours, outline_table

_ROOT = 6
_KEPT = 64  # rendered hands, some MB each
_AT_ONCE = 128
_LOOK = ("noise", "blur_px", "skin", "ambient", "shape_spread", "cameras")
"""Fields of a trial that rendered pictures depend on."""
_CONTOURS = {
    "contour": ContourSettings(contour_weight=0.0, valley_weight=0.0),
    "distance_map": ContourSettings(coverage_weight=0.0),
    "outline": ContourSettings(),
    "all": ContourSettings(),
}


def planned(study: Study) -> list[StudyBatch]:
    """Batches: every cell on every picture that has trials in it, cell by cell."""
    plan = []
    for cell in study.cells:
        for picture in range(study.pictures):
            trials = study.trials // study.pictures + (picture < study.trials % study.pictures)
            count = trials * cell.trial.hypotheses
            place = cell.index * study.pictures + picture
            plan.append(StudyBatch(index=place, case=place, first=0, count=count))
    return plan


class CellRegistration:
    """Registers batches of a study, on the device it is given; what it keeps from one to the next changes no number.

    Hands, pictures and starts are drawn by the processor, the same for any device.
    """

    def __init__(self, study: Study, device: torch.device | str = HOST) -> None:
        self.study, self.device = study, torch.device(device)
        self._prior = load_hand_model().prior(dtype=torch.float64)
        self._model = load_hand_model().to(device=self.device)
        self._kinematics = self._model.kinematics(SIDE, dtype=torch.float64)
        self._postures = PostureResiduals.of(self._model.prior().postures)
        self._constraints = PoseConstraints(self._model.skeleton)
        self._rendered = lru_cache(maxsize=_KEPT)(self._render)

    def _render(self, number: int, *look: Any) -> RenderedHand:
        """The hand of that number; look: of the trial, what its pictures depend on (`_LOOK`)."""
        trial = Trial(**dict(zip(_LOOK, look, strict=True)))
        return rendered_hand(number, trial, self.study.space, self._prior, self.study.seed)

    def __call__(self, batch: StudyBatch) -> Hypotheses:
        """The same for the same study, whatever was done before."""
        index, number = divmod(batch.case, self.study.pictures)
        trial = self.study.cells[index].trial
        seed = seed_of(self.study.seed, "cell", index, number)
        generator = torch.Generator().manual_seed(seed)
        look = (getattr(trial, name) for name in _LOOK)
        hand = seen_hand(self._rendered(number, *look), trial, generator)
        space = named_pose_space(self.study.space).about(hand.pose.dofs)
        change = (trial.scale * trial.perturbation.draw(space, batch.count, generator)).to(self.device)
        std = (trial.scale * trial.perturbation.std(space)).clamp_min(1e-4).to(self.device)
        hand, space = sent_to(hand, self.device), sent_to(space, self.device)
        change = change.clamp(*free_bounds(space, self._model.skeleton))
        starts = HandPose.of(space.dof(change), hand.pose.reference)
        found = self._registered(hand, trial, space, starts, std)
        return self._recorded(batch, seed, hand, space, change, found)

    def _registered(
        self, hand: SeenHand, trial: Trial, space: PoseSpace, starts: HandPose, std: Float[Tensor, "free"]
    ) -> Solutions:
        """std: of the starts."""
        shape = self._kinematics.default_shape
        belief = GaussianPrior.of_std(starts, std, space) if self.study.has_start_prior else None
        observations = [one for i, view in enumerate(hand.views) for one in self._observations(view, i, trial)]
        problem = Problem(
            space=space,
            skeleton=self._model.skeleton,
            shape=shape,
            observations=tuple(observations),
            priors=study_priors(self._constraints, self._postures, belief),
        )
        return solve(problem, starts, SEARCH, at_once=_AT_ONCE)

    def _observations(self, view: SeenView, index: int, trial: Trial) -> list[Observation]:
        camera, found = view.camera.to(dtype=torch.float64), list[Observation]()
        if trial.observation in _CONTOURS:
            settings = _CONTOURS[trial.observation]
            projector = HandProjector(self._kinematics, camera, self._kinematics.default_shape)
            table = sent_to(outline_table(12, 8, without=("palm_wrist",)), self.device)
            contours = PrimitiveContours(projector, table)
            picture = picture_contours(view.mask, SEARCH, settings, image=view.image)
            found.append(ContourObservation(picture=picture, contours=contours, settings=settings, view=index))
        if trial.observation in ("points", "all"):
            settings = KeypointSettings(std_m=1e-3 * trial.point_std_mm, correlation=0.0)  # as they were drawn
            points = view.points_px[None]
            found.append(
                PictureKeypoints(
                    points_px=points, kinematics=self._kinematics, camera=camera, settings=settings, view=index
                )
            )
        return found

    def _recorded(
        self,
        batch: StudyBatch,
        seed: int,
        hand: SeenHand,
        space: PoseSpace,
        change: Float[Tensor, "starts free"],
        found: Solutions,
    ) -> Hypotheses:
        starts = HandPose.of(space.dof(change), hand.pose.reference)
        begun, ended = self._errors(hand, space, starts), self._errors(hand, space, found.pose)
        failed = found.status > SolveStatus.STALLED.value
        outlines = [one.distance for one in found.explained if one.name == "contour"]
        distance = torch.stack(outlines).mean(0) if outlines else torch.full_like(found.cost, torch.nan)

        def known(values: Tensor) -> np.ndarray:
            shaped = failed.reshape(-1, *(1,) * (values.ndim - 1))
            return read_back(torch.where(shaped, torch.nan, values))

        return Hypotheses(
            frame=np.full(batch.count, hand.number),
            batch=np.full(batch.count, batch.index),
            seed=np.full(batch.count, seed),
            level=np.ones(batch.count, dtype=np.int64),
            perturbation=read_back(change),
            start_angle_deg=read_back(begun.angle_deg),
            start_keypoint_mm=read_back(begun.keypoint_mm),
            start_rotation_deg=read_back(begun.rotation_deg),
            angle_deg=known(ended.angle_deg),
            keypoint_mm=known(ended.keypoint_mm),
            rotation_deg=known(ended.rotation_deg),
            contour_px=known(distance),
            cost=read_back(torch.where(failed, torch.inf, found.cost)),
            misfit=read_back(torch.where(failed, torch.inf, found.misfit)),
            status=read_back(found.status),
            iterations=read_back(found.iterations),
            pose=known(found.pose.vector),
        )

    def _errors(self, hand: SeenHand, space: PoseSpace, hands: HandPose) -> PoseErrors:
        truth, joints, shape = hand.pose, space.basis[_ROOT:].any(-1), self._kinematics.default_shape
        return pose_errors(self._kinematics, shape, hands.dofs, hands.reference, truth.dofs, truth.reference, joints)
