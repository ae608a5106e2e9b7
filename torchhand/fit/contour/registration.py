"""Registration of a hand on the contours of one picture, for many hypotheses at once (paper 000, section 7.4).

From coarse to fine, each level looks at the posed models a few times (which points of their contours are visible, which
belong to which points of the picture's) and between two looks lets an optimiser run on the distance maps, with the
root's rotation about its place at the look. Both sides count: the model's outline must lie on the picture's contour,
and the picture's contour on the model's outline.
"""

from dataclasses import dataclass, fields, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.fit import Beliefs, Expectation, PostureResiduals, free_bounds
from torchhand.fit.contour.cost import RegistrationCost
from torchhand.fit.contour.judged import Judged, covariance_of
from torchhand.fit.contour.look import Looker, hand_length_px
from torchhand.fit.contour.picture_contours import PictureContours
from torchhand.fit.contour.result import Registration, RegistrationStatus
from torchhand.fit.contour.settings import RegistrationLevel, RegistrationSettings
from torchhand.hand import DOFS, PoseConstraints, PoseSpace, rebased
from torchhand.hand.limits import clamp_to_limits
from torchhand.numerics import (
    DescentSettings,
    LeastSquares,
    LevenbergMarquardtSettings,
    NormalEquations,
    Status,
    gradient_descent,
    levenberg_marquardt,
)
from torchhand.view import Contours

__all__ = ["Registration", "RegistrationStatus", "covariance_of", "free_bounds", "register"]

_ROTATIONS = ("root_rx", "root_ry", "root_rz")
_COST_TOLERANCE = 1e-3  # share of the cost below which a step is not worth taking
_STEP_TOLERANCE = 1e-5
_DAMPING = 1e-2
_DESCENT = 10  # times the iterations


def register(
    picture: PictureContours,
    contours: Contours,
    space: PoseSpace,
    pose: Float[Tensor, "*hypotheses 36"],
    root_reference: Float[Tensor, "*#hypotheses 3 3"],
    settings: RegistrationSettings | None = None,
    *,
    constraints: PoseConstraints | None = None,
    prior: PostureResiduals | None = None,
    expected: Expectation | None = None,
) -> Registration:
    """Fit poses of a pose space to a picture, every hypothesis from its own start.

    picture: made with the same settings.
    contours: of the surface to fit (primitives or mesh), with the space's basis.
    space: in the dtype to compute in (float64 is meant). Starts are put into it; to keep what a small space does not
        know, give `space.about(pose)`. Rotations of the root are about its reference, whatever the space's own is.
    constraints: paper 000's dynamic constraints as soft walls; the static limits hold in any case.
    prior: which postures are likely. expected: the pose that is expected, such as a prediction, in the same space, for
        all hypotheses or for each.

    Never raises for what a picture or a start may be: see `RegistrationStatus`. One hypothesis never touches another.
    """
    settings = settings or RegistrationSettings()
    if len(picture.fields) != len(settings.levels):
        raise ValueError(
            f"picture: expected {len(settings.levels)} levels as in the settings, got {len(picture.fields)}"
        )
    batch = pose.shape[:-1]
    flat = pose.reshape(-1, len(DOFS)).to(space.basis)
    reference = root_reference.to(flat).expand(*batch, 3, 3).reshape(-1, 3, 3)
    if expected is not None:
        expected = Expectation(
            free=expected.free.expand(*batch, -1).reshape(-1, space.size),
            root_reference=expected.root_reference.expand(*batch, 3, 3).reshape(-1, 3, 3),
            whitening=expected.whitening.expand(*batch, -1, -1).reshape(-1, space.size, space.size),
        )
    turning = torch.tensor([name in _ROTATIONS for name in DOFS], device=flat.device)
    space = replace(space, constant=space.constant.masked_fill(turning, 0.0))
    work = _Work(
        picture=picture,
        contours=contours,
        settings=settings,
        beliefs=Beliefs.of(
            space,
            constraints,
            prior,
            constraint_weight=settings.constraint_weight,
            prior_weight=settings.prior_weight,
        ),
        inverse=torch.linalg.pinv(space.basis),
        bounds=free_bounds(space, contours.kinematics.skeleton),
        columns=tuple(space.free_names.index(name) if name in space.free_names else -1 for name in _ROTATIONS),
    )
    size = settings.hypotheses_at_once
    done = []
    for start in range(0, max(1, len(flat)), size):
        part = slice(start, start + size)
        own = None
        if expected is not None:
            own = Expectation(**{f.name: getattr(expected, f.name)[part] for f in fields(expected)})
        with torch.inference_mode():  # a sixth faster than without gradients alone
            done.append(work.register(flat[part], reference[part], own))
    whole = {f.name: torch.cat([getattr(one, f.name) for one in done]) for f in fields(Registration)}
    return Registration(**{name: value.reshape((*batch, *value.shape[1:])) for name, value in whole.items()})


@dataclass(frozen=True, kw_only=True)
class _Work:
    """One registration's ingredients."""

    picture: PictureContours
    contours: Contours
    settings: RegistrationSettings
    beliefs: Beliefs
    inverse: Float[Tensor, "free 36"]
    bounds: tuple[Float[Tensor, "free"], Float[Tensor, "free"]]
    columns: tuple[int, ...]

    def register(
        self, pose: Float[Tensor, "k 36"], reference: Float[Tensor, "k 3 3"], expected: Expectation | None
    ) -> Registration:
        start = rebased(pose, reference)
        if self.picture.is_empty or not len(pose):
            return self._unmoved(*start, RegistrationStatus.NO_CONTOUR)
        looker = Looker(
            picture=self.picture,
            contours=self.contours,
            settings=self.settings,
            beliefs=self.beliefs,
            length_px=hand_length_px(self.contours, start[0]),
        )

        def looked(level: int) -> RegistrationCost:
            about = None if expected is None else expected.about(reference, self.columns)
            return looker(self._pose(values), reference, level, about)

        values, reference = self._free(start[0]).clamp(*self.bounds), start[1]
        iterations = torch.zeros(len(pose), dtype=torch.long, device=pose.device)
        status, kept = torch.zeros_like(iterations), None
        last = len(self.settings.levels) - 1
        for index, level in enumerate(self.settings.levels):
            for turn in range(level.rounds):
                cost = looked(index)
                if index == last and turn == 0:
                    kept = Judged.of(cost, values, looker.robust_px(last))
                    first = kept.equations
                else:
                    first = cost.at_look(values)
                found = self._optimised(cost, values, level, first)
                status, iterations = found.status, iterations + found.iterations
                values, reference = self._settled(found.values, reference)
        assert kept is not None
        kept = kept.or_better(Judged.of(looked(last), values, looker.robust_px(last)))
        return self._finished(kept, start, status, iterations)

    def _settled(self, values: Tensor, reference: Tensor) -> tuple[Tensor, Tensor]:
        """The same hands, the rotation taken into the reference."""
        _, reference = rebased(self._pose(values), reference)
        own = torch.tensor([c for c in self.columns if c >= 0], dtype=torch.long, device=values.device)
        return values.index_fill(-1, own, 0.0), reference

    def _pose(self, values: Tensor) -> Tensor:
        return clamp_to_limits(self.beliefs.space.dof(values), self.contours.kinematics.skeleton)

    def _free(self, pose: Tensor) -> Tensor:
        return (pose - self.beliefs.space.constant) @ self.inverse.T

    def _optimised(
        self, cost: RegistrationCost, values: Tensor, level: RegistrationLevel, first: NormalEquations
    ) -> LeastSquares:
        lower, upper = self.bounds
        if self.settings.method == "descent":
            descent = DescentSettings(iterations=_DESCENT * level.iterations, cost_tolerance=0.1 * _COST_TOLERANCE)
            return gradient_descent(cost.equations, values, lower=lower, upper=upper, settings=descent, takes_rows=True)
        newton = LevenbergMarquardtSettings(
            iterations=level.iterations,
            damping=_DAMPING,
            cost_tolerance=_COST_TOLERANCE,
            step_tolerance=_STEP_TOLERANCE,
        )
        return levenberg_marquardt(
            cost.equations, values, lower=lower, upper=upper, settings=newton, takes_rows=True, first=first
        )

    def _finished(self, kept: Judged, start: tuple[Tensor, Tensor], status: Tensor, iterations: Tensor) -> Registration:
        failed = ~kept.cost.isfinite()
        status = torch.where(failed, RegistrationStatus.FAILED.value, status.clamp_max(Status.STALLED.value))
        return Registration(
            pose=torch.where(failed[:, None], start[0], self._pose(kept.values)),
            root_reference=torch.where(failed[:, None, None], start[1], kept.reference),
            cost=kept.cost,
            contour_px=kept.contour_px,
            status=status,
            iterations=iterations,
            covariance=covariance_of(kept.equations.matrix, ~failed),
        )

    def _unmoved(self, pose: Tensor, reference: Tensor, status: RegistrationStatus) -> Registration:
        size, count = self.beliefs.space.size, len(pose)
        nothing = torch.full((count,), torch.inf, dtype=pose.dtype, device=pose.device)
        zeros = torch.zeros(count, dtype=torch.long, device=pose.device)
        return Registration(
            pose=pose,
            root_reference=reference,
            cost=nothing,
            contour_px=nothing.clone(),
            status=zeros + status.value,
            iterations=zeros,
            covariance=torch.full((count, size, size), torch.nan, dtype=pose.dtype, device=pose.device),
        )
