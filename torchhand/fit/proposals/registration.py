"""Registration of proposed hands on a silhouette, all of them at once: the cheapest explains it best."""

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.fit import (
    ConstraintPrior,
    GaussianPrior,
    PosturePrior,
    PostureResiduals,
    Problem,
    Schedule,
    Solutions,
    solve,
)
from torchhand.fit.contour import SEARCH, ContourObservation, ContourSettings, picture_contours
from torchhand.hand import HandKinematics, HandPose, HandPrior, PoseConstraints, named_pose_space
from torchhand.propose import Silhouette
from torchhand.view import HandProjector, OutlineTable, PrimitiveContours, outline_table

_PLACE_STD, _DEPTH_STD, _TURN_STD, _ANGLE_STD = 0.02, 0.06, math.radians(20), math.radians(20)
"""How far proposals are off, metres and radians: the errors of the best of eight, with a margin."""
_MIN_WEIGHT = 1e-4  # of a hypothesis, for its share of the cost


@dataclass(frozen=True, kw_only=True)
class ProposalRegistration:
    """What the registrations of proposals have in common, whatever the picture."""

    kinematics: HandKinematics
    """float64"""
    contour: ContourSettings = field(default_factory=ContourSettings)
    schedule: Schedule = SEARCH

    @cached_property
    def _table(self) -> OutlineTable:
        return outline_table(10, 12, without=("palm_wrist",))

    @cached_property
    def _postures(self) -> PostureResiduals:
        return PostureResiduals.of(HandPrior(self.kinematics.skeleton, self.kinematics.shape_space).postures)

    def __call__(
        self, silhouette: Silhouette, starts: HandPose, shape: Float[Tensor, "shape"], *, weight: Tensor | None = None
    ) -> Solutions:
        """Each of the starts (k), finite and in the world, registered by itself: 27 degrees of freedom on distance maps
        of the outline, and valleys where the picture is there; likely postures near its own are preferred.

        weight: (k) probabilities of the starts, whose negative logarithms are then added to the costs.
        """
        space = named_pose_space("dof27")
        expected = GaussianPrior.of_std(starts, _std(space.free_names), space)
        picture = picture_contours(silhouette.mask, self.schedule, self.contour, image=silhouette.image)
        camera = silhouette.camera.to(dtype=torch.float64)
        contours = PrimitiveContours(HandProjector(self.kinematics, camera, shape), self._table)
        problem = Problem(
            space=space,
            skeleton=self.kinematics.skeleton,
            shape=shape,
            observations=(ContourObservation(picture=picture, contours=contours, settings=self.contour),),
            priors=(
                ConstraintPrior(constraints=PoseConstraints(self.kinematics.skeleton), has_ties=False),
                PosturePrior(postures=self._postures),
                expected,
            ),
        )
        found = solve(problem, starts, self.schedule)
        if weight is None:
            return found
        return replace(found, cost=found.cost - weight.to(found.cost).clamp_min(_MIN_WEIGHT).log())


def _std(names: tuple[str, ...]) -> Float[Tensor, "free"]:
    kinds = {"root_tx": _PLACE_STD, "root_ty": _PLACE_STD, "root_tz": _DEPTH_STD}
    kinds |= dict.fromkeys(("root_rx", "root_ry", "root_rz"), _TURN_STD)
    return torch.tensor([kinds.get(name, _ANGLE_STD) for name in names], dtype=torch.float64)
