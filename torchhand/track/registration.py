"""Registration of a hand on the contours of one picture, for many hypotheses at once (paper 000, section 7.4).

From coarse to fine, each level looks at the posed models a few times (which points of their contours are visible, which
belong to which points of the picture's) and between two looks lets an optimiser run on the distance maps, with the
root's rotation about its place at the look. Both sides count: the model's outline must lie on the picture's contour,
and the picture's contour on the model's outline.
"""

from dataclasses import dataclass, fields

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.hand import DOFS, PoseConstraints, PoseSpace, Skeleton, rebased
from torchhand.image.distance_fields import channel_of
from torchhand.numerics import (
    LeastSquares,
    LevenbergMarquardtSettings,
    NormalEquations,
    RobustLoss,
    Status,
    levenberg_marquardt,
)
from torchhand.numerics.descent import DescentSettings, gradient_descent
from torchhand.residuals import DynamicConstraints, Expectation, PostureResiduals, match_boundary
from torchhand.track.limits import clamp_to_limits
from torchhand.track.picture_contours import PictureContours
from torchhand.track.registration_cost import Beliefs, LookedAt, RegistrationCost
from torchhand.track.registration_result import Registration, RegistrationStatus
from torchhand.track.registration_settings import RegistrationLevel, RegistrationSettings
from torchhand.view.contours import ContourLook, Contours

__all__ = ["Registration", "RegistrationStatus", "covariance_of", "own_limits", "register"]

_ROTATIONS = ("root_rx", "root_ry", "root_rz")
_ROOT = 6
_STEEP = 0.15  # share of the hand's length: a palm seen shorter than this has no direction in the picture
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
        know, give `space.about(pose)`.
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
    work = _Work(
        picture=picture,
        contours=contours,
        settings=settings,
        beliefs=_beliefs(space, settings, constraints, prior),
        inverse=torch.linalg.pinv(space.basis),
        bounds=own_limits(space, contours.kinematics.skeleton),
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


def covariance_of(
    matrix: Float[Tensor, "hypotheses free free"], is_good: Bool[Tensor, "hypotheses"]
) -> Float[Tensor, "hypotheses free free"]:
    """Inverses of the matrices of the normal equations; NaN where they are not positive definite or not good."""
    identity = torch.eye(matrix.shape[-1], dtype=matrix.dtype, device=matrix.device)
    factor, info = torch.linalg.cholesky_ex(torch.where(is_good[:, None, None], matrix, identity))
    is_known = ((info == 0) & is_good)[:, None, None]
    return torch.where(is_known, torch.cholesky_inverse(torch.where(is_known, factor, identity)), torch.nan)


def own_limits(space: PoseSpace, skeleton: Skeleton) -> tuple[Float[Tensor, "free"], Float[Tensor, "free"]]:
    """Bounds of the free parameters: each keeps the angle that it is named after within its limits.

    An angle that is tied to another stops at its own limit while the other goes on (as paper 000's equation 4 must be
    read, FACTS section 2.2). Parameters of the root, and those not named after an angle, have infinite bounds.
    """
    basis, constant = space.basis, space.constant
    lower = torch.full((space.size,), -torch.inf, dtype=basis.dtype, device=basis.device)
    upper = -lower
    for column, name in enumerate(space.free_names):
        row = DOFS.index(name) if name in DOFS else 0
        factor = float(basis[row, column])
        if row >= _ROOT and factor != 0:
            limits = (float(limit[row - _ROOT]) for limit in (skeleton.lower, skeleton.upper))
            lower[column], upper[column] = sorted((limit - float(constant[row])) / factor for limit in limits)
    return lower, upper


def _beliefs(
    space: PoseSpace,
    settings: RegistrationSettings,
    constraints: PoseConstraints | None,
    prior: PostureResiduals | None,
) -> Beliefs:
    moves_joints = bool(space.basis[_ROOT:].any())
    dynamic = None
    if constraints is not None and moves_joints and settings.constraint_weight > 0:
        dynamic = DynamicConstraints(constraints=constraints, basis=space.basis)
    return Beliefs(
        space=space,
        constraints=dynamic,
        constraint_weight=settings.constraint_weight,
        prior=prior if moves_joints and settings.prior_weight > 0 else None,
        prior_weight=settings.prior_weight,
    )


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
        length = self._length_px(start[0])
        values, reference = self._free(start[0]).clamp(*self.bounds), start[1]
        iterations = torch.zeros(len(pose), dtype=torch.long, device=pose.device)
        status, kept = torch.zeros_like(iterations), None
        last = len(self.settings.levels) - 1
        for index, level in enumerate(self.settings.levels):
            for turn in range(level.rounds):
                moved, reference = rebased(self._pose(values), reference)
                values = values.index_fill(-1, self._rotations, 0.0)
                cost = self._look(moved, reference, expected, index, length)
                values, first = values.clamp(*self.bounds), None
                if index == last and turn == 0:
                    kept = self._judged(cost, values)
                    first = kept.equations
                found = self._optimised(cost, values, level, first)
                values, status = found.values, found.status
                iterations += found.iterations
        assert kept is not None
        moved, reference = rebased(self._pose(values), reference)
        values = values.index_fill(-1, self._rotations, 0.0)
        kept = kept.or_better(self._judged(self._look(moved, reference, expected, last, length), values))
        return self._finished(kept, start, status, iterations)

    @property
    def _rotations(self) -> Tensor:
        """Places of the rotation among the free parameters, which every look takes into the reference."""
        return torch.tensor([c for c in self.columns if c >= 0], dtype=torch.long, device=self.inverse.device)

    def _pose(self, values: Tensor) -> Tensor:
        return clamp_to_limits(self.beliefs.space.dof(values), self.contours.kinematics.skeleton)

    def _free(self, pose: Tensor) -> Tensor:
        return (pose - self.beliefs.space.constant) @ self.inverse.T

    def _length_px(self, pose: Tensor) -> float:
        """Length in the picture of a hand held parallel to it at the hypotheses' median depth."""
        camera, kinematics = self.contours.camera, self.contours.kinematics
        length = float(self.contours.shape[kinematics.shape_space.names.index("hand_length")])
        focal = 0.5 * float(camera.intrinsics[0, 0] + camera.intrinsics[1, 1])
        if camera.kind == "orthographic":
            return focal * length
        depth = camera.cam_from_world(pose[:, :3])[:, 2]
        depth = depth[depth.isfinite() & (depth > 0)]
        return focal * length / float(depth.median()) if len(depth) else float(camera.height)

    def _look(
        self,
        pose: Tensor,
        reference: Tensor,
        expected: Expectation | None,
        index: int,
        length: float,
    ) -> RegistrationCost:
        settings, level, picture = self.settings, self.settings.levels[index], self.picture
        field, boundary = picture.fields[index], picture.boundary
        look = self.contours.look(pose, reference, beyond_px=1 + settings.beyond_share * length)
        robust_px = level.robust_share * length
        match = match_boundary(boundary, look.points_px, look.normals, look.outer, turn_px=settings.turn_share * length)
        precision = max(settings.contour_std_px, settings.contour_std_share * robust_px) ** -2
        outer = look.outer.to(pose)
        each = settings.contour_weight * precision / outer.sum(-1, keepdim=True).clamp_min(1)
        is_fingerwards = _fingerwards(look, boundary.points_px.to(pose), _STEEP * length).to(pose)
        of_each = settings.coverage_weight * precision / is_fingerwards.sum(-1, keepdim=True).clamp_min(1)
        prior = self.beliefs.prior
        posture = torch.zeros(len(pose), dtype=torch.long, device=pose.device)
        held = LookedAt(
            root_reference=reference,
            look=look,
            channel=channel_of(look.normals, field.channels),
            match=match,
            outer_weight=each * outer,
            inner_weight=settings.valley_weight * each * look.inner.to(pose),
            coverage_weight=of_each * is_fingerwards,
            posture=posture if prior is None else prior.likeliest(pose.nan_to_num()),
            expected=None if expected is None else expected.about(reference, self.columns),
        )
        return RegistrationCost(
            contours=self.contours,
            beliefs=self.beliefs,
            held=held,
            field=field,
            boundary=boundary,
            valleys=picture.valleys,
            robust=RobustLoss(kind="geman_mcclure", scale=robust_px),
            valley_robust=RobustLoss(kind="geman_mcclure", scale=settings.valley_robust_share * length),
            unmatched_px=length,
        )

    def _optimised(
        self, cost: RegistrationCost, values: Tensor, level: RegistrationLevel, first: NormalEquations | None
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

    def _judged(self, cost: RegistrationCost, values: Tensor) -> "_Judged":
        """What a fresh look makes of some values."""
        held, boundary = cost.held, cost.boundary.points_px.to(values)
        found = cost.equations(values, torch.arange(len(values), device=values.device))
        index = held.match.clamp_min(0)[..., None].expand(-1, -1, 2)
        offset = held.look.points_px.gather(1, index) - boundary
        offset = (offset * held.look.normals.gather(1, index)).sum(-1).abs().clamp_max(cost.robust.scale)
        offset = torch.where(held.match < 0, cost.robust.scale, offset)
        share = held.coverage_weight
        mean = torch.where(share > 0, offset * share, 0.0).sum(-1) / share.sum(-1).clamp_min(1e-30)
        is_seen = held.look.outer.any(-1) & found.cost.isfinite() & found.gradient.isfinite().all(-1)
        return _Judged(
            values=values,
            reference=held.root_reference,
            cost=torch.where(is_seen, found.cost, torch.inf),
            contour_px=torch.where(is_seen, mean, torch.inf),
            equations=found,
        )

    def _finished(
        self, kept: "_Judged", start: tuple[Tensor, Tensor], status: Tensor, iterations: Tensor
    ) -> Registration:
        pose, reference = rebased(self._pose(kept.values), kept.reference)
        failed = ~kept.cost.isfinite()
        status = torch.where(failed, RegistrationStatus.FAILED.value, status.clamp_max(Status.STALLED.value))
        return Registration(
            pose=torch.where(failed[:, None], start[0], pose),
            root_reference=torch.where(failed[:, None, None], start[1], reference),
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


@dataclass(frozen=True, kw_only=True)
class _Judged:
    """Values that have been looked at anew, and what they cost; a row per hypothesis."""

    values: Float[Tensor, "k free"]
    reference: Float[Tensor, "k 3 3"]
    cost: Float[Tensor, "k"]
    contour_px: Float[Tensor, "k"]
    equations: NormalEquations
    """As computed, of failed ones too."""

    def or_better(self, other: "_Judged") -> "_Judged":
        """The cheaper of the two, hypothesis by hypothesis."""
        better = other.cost <= self.cost

        def chosen(one: Tensor, two: Tensor) -> Tensor:
            return torch.where(better.reshape(-1, *(1,) * (one.ndim - 1)), two, one)

        pairs = {
            f.name: (getattr(self.equations, f.name), getattr(other.equations, f.name)) for f in fields(NormalEquations)
        }
        return _Judged(
            values=chosen(self.values, other.values),
            reference=chosen(self.reference, other.reference),
            cost=chosen(self.cost, other.cost),
            contour_px=chosen(self.contour_px, other.contour_px),
            equations=NormalEquations(**{name: chosen(*pair) for name, pair in pairs.items()}),
        )


def _fingerwards(
    look: ContourLook, boundary_px: Float[Tensor, "boundary 2"], least_px: float
) -> Bool[Tensor, "hands boundary"]:
    """Which of the picture's points are on the fingers' side of the wrist: beyond it there may be a forearm."""
    length = look.fingerwards_px.norm(dim=-1)
    ahead = ((boundary_px - look.wrist_px[:, None]) * look.fingerwards_px[:, None]).sum(-1)
    return (ahead > 0) | ~(length > least_px)[:, None]
