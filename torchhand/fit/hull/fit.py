"""A skinned hand fitted into a visual hull by least squares, for many hypotheses at once.

Both sides count: the skin must be inside the hull (all that silhouettes say for certain), and every ray through a
silhouette's edge must touch the skin (`hull_rims`). Where the edges are not known, the hull's surface should be on the
skin, with less weight (a visual hull has volume that no hand fills). Palm and fingers move together. From coarse to
fine, each level looks at the posed skins a few times, which vertex belongs to which point of the hull's surface, and
lets Levenberg-Marquardt run between two looks, with the root's rotation about its place at the look.
"""

from dataclasses import dataclass, fields
from enum import IntEnum

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.fit import Beliefs, DynamicConstraints, Expectation, PostureResiduals, covariance_of, free_bounds
from torchhand.fit.hull.cost import HeldHull, HullCost
from torchhand.fit.hull.covered import match_hull
from torchhand.fit.hull.look import EndedFits, HullLook, SeenHull
from torchhand.fit.hull.points import HullTarget, spread_vertices
from torchhand.fit.hull.settings import HullFitSettings, HullLevel
from torchhand.fit.hull.skin import PosedBones, SkinPoints
from torchhand.hand import DOFS, Hand, PoseConstraints, PoseSpace, rebased
from torchhand.hand.limits import clamp_to_limits
from torchhand.numerics import LeastSquares, LevenbergMarquardtSettings, RobustLoss, Status, levenberg_marquardt
from torchhand.numerics.least_squares import damped_box_step

_ROTATIONS = ("root_rx", "root_ry", "root_rz")
_ROOT = 6
_ARRIVED = 0.02  # share of the cost that the next step promises, where a fit without judgement counts as converged
_BESIDE = 0.008  # metres along the surface to the nearest vertex, beyond which there is no skin there
_COST_TOLERANCE = 1e-3  # share of the cost below which a step is not worth taking
_STEP_TOLERANCE = 1e-5
_DAMPING = 1e-2


class HullStatus(IntEnum):
    """How a hypothesis ended."""

    CONVERGED = Status.CONVERGED.value
    """No step promises a noticeable decrease of the cost."""
    STALLED = Status.STALLED.value
    """Out of iterations: the best pose found."""
    FAILED = Status.FAILED.value
    """The start was not finite: the start."""
    NO_HULL = 3
    """The silhouettes leave no volume: the start."""


@dataclass(frozen=True, kw_only=True)
class HullFit:
    """Fitted hands, one per hypothesis, in the world."""

    pose: Float[Tensor, "*hypotheses 36"]
    """Metres and radians, with a zero rotation vector, within the limits."""
    root_reference: Float[Tensor, "*hypotheses 3 3"]
    """world_from_hand"""
    cost: Float[Tensor, "*hypotheses"]
    """Half the weighted sum of the robust losses at the finest level: comparable between hypotheses; infinite if
    failed."""
    inside_share: Float[Tensor, "*hypotheses"]
    """Share of the skin's area inside the hull (paper 002's rate of convergence); NaN if failed."""
    apart_m: Float[Tensor, "*hypotheses"]
    """Mean distance of the silhouettes' edges, or else of the hull's surface, from the skin, metres, cut off at the
    finest level's robust distance; infinite if failed."""
    covered_share: Float[Tensor, "*hypotheses"]
    """Share of those edges, or else of that surface, with skin no farther than the settings' `near_m`; 0 if failed."""
    is_good: Bool[Tensor, "*hypotheses"]
    """Whether a hand is there as fitted, by `least_covered` and `least_held` of the settings: False for a hull of
    something else, for a finger in the wrong place that leaves much unexplained, and where the fit failed."""
    status: Int[Tensor, "*hypotheses"]
    """Numbers of `HullStatus`."""
    iterations: Int[Tensor, "*hypotheses"]
    """Evaluations over all looks."""
    covariance: Float[Tensor, "*hypotheses free free"]
    """Of the free parameters, the rotation as a left perturbation of the root reference; NaN if failed. On simulated
    people of known shape with a pixel of noise the squared error is about what it says; what another shape or another
    maker's skin is off by is not in it."""

    @property
    def best(self) -> int:
        """Place of the lowest cost among the flattened hypotheses."""
        return int(self.cost.reshape(-1).argmin())

    def select(self, index: int) -> "HullFit":
        """One of the flattened hypotheses, without batch dimensions."""
        return self.rows(torch.tensor([index]))._squeezed()

    def rows(self, rows: Int[Tensor, "n"]) -> "HullFit":
        """Some of the flattened hypotheses, in the order given."""
        lead = self.status.ndim
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        flat = {name: value.reshape(-1, *value.shape[lead:]) for name, value in values.items()}
        return HullFit(**{name: value[rows.to(value.device)] for name, value in flat.items()})

    def _squeezed(self) -> "HullFit":
        return HullFit(**{f.name: getattr(self, f.name)[0] for f in fields(self)})


class HullFitter:
    """Fits one hand of one shape, in one pose space, to any number of hulls.

    hand: in the dtype to compute its skin in; shape: in place of its own. space: in the dtype to solve in (float64 is
        meant). Starts are put into it.
    constraints: paper 000's dynamic constraints as soft walls; the static limits hold in any case. prior: which
        postures are likely.
    """

    def __init__(
        self,
        hand: Hand,
        space: PoseSpace,
        settings: HullFitSettings | None = None,
        *,
        shape: Float[Tensor, "shape"] | None = None,
        constraints: PoseConstraints | None = None,
        prior: PostureResiduals | None = None,
    ) -> None:
        self.settings = settings or HullFitSettings()
        self.skin = SkinPoints(hand, space.basis, shape)
        moves_joints = bool(space.basis[_ROOT:].any())
        weight, prior_weight = self.settings.constraint_weight, self.settings.prior_weight
        dynamic = None
        if constraints is not None and moves_joints and weight > 0:
            dynamic = DynamicConstraints(constraints=constraints)
        self.beliefs = Beliefs(
            space=space,
            constraints=dynamic,
            constraint_weight=weight,
            prior=prior if moves_joints and prior_weight > 0 else None,
            prior_weight=prior_weight,
            prior_tail=self.settings.prior_tail,
        )
        vertices, share = spread_vertices(hand, self.settings.vertices)
        self.vertices, self._share = vertices, share
        self._inside = self.skin.loads(vertices)
        self._firm = hand.skinning.weights.amax(0) ** self.settings.firmness
        self._inverse = torch.linalg.pinv(space.basis)
        self._bounds = free_bounds(space, hand.kinematics.skeleton)
        self._columns = tuple(space.free_names.index(name) if name in space.free_names else -1 for name in _ROTATIONS)
        self._rotations = torch.tensor([c for c in self._columns if c >= 0], dtype=torch.long)

    def __call__(
        self,
        target: HullTarget,
        pose: Float[Tensor, "*hypotheses 36"],
        root_reference: Float[Tensor, "*#hypotheses 3 3"],
        *,
        expected: Expectation | None = None,
    ) -> HullFit:
        """Every hypothesis from its own start.

        expected: the pose that is expected, such as a prediction, in the same space, for all hypotheses or for each.

        Never raises for what a hull or a start may be: see `HullStatus`. One hypothesis never touches another.
        """
        space, batch = self.beliefs.space, pose.shape[:-1]
        flat = pose.reshape(-1, len(DOFS)).to(space.basis)
        reference = root_reference.to(flat).expand(*batch, 3, 3).reshape(-1, 3, 3)
        if expected is not None:
            expected = Expectation(
                free=expected.free.expand(*batch, -1).reshape(-1, space.size),
                root_reference=expected.root_reference.expand(*batch, 3, 3).reshape(-1, 3, 3),
                whitening=expected.whitening.expand(*batch, -1, -1).reshape(-1, space.size, space.size),
            )
        size = self.settings.hypotheses_at_once
        done = []
        for start in range(0, max(1, len(flat)), size):
            part = slice(start, start + size)
            own = None
            if expected is not None:
                own = Expectation(**{f.name: getattr(expected, f.name)[part] for f in fields(expected)})
            with torch.inference_mode():
                done.append(self._fit(target, flat[part], reference[part], own))
        whole = {f.name: torch.cat([getattr(one, f.name) for one in done]) for f in fields(HullFit)}
        return HullFit(**{name: value.reshape((*batch, *value.shape[1:])) for name, value in whole.items()})

    def _fit(self, target: HullTarget, pose: Tensor, reference: Tensor, expected: Expectation | None) -> HullFit:
        start = rebased(pose, reference)
        if target.is_empty or not len(pose):
            return self._unmoved(*start, HullStatus.NO_HULL)
        values, reference = self._free(start[0]).clamp(*self._bounds), start[1]
        iterations = torch.zeros(len(pose), dtype=torch.long, device=pose.device)
        lower, upper = self._bounds
        kept: EndedFits | None = None
        for index, level in enumerate(self.settings.levels):
            for _ in range(level.rounds):
                found, after, look = self._moved(target, values, reference, expected, level)
                iterations += found.iterations
                if index == len(self.settings.levels) - 1:
                    ended = self._ended(target, found, reference, None if level.is_judged else look)
                    kept = ended if kept is None else kept.or_better(ended)
                reference = rebased(self._pose(after), reference)[1]
                values = after.index_fill(-1, self._rotations, 0.0).clamp(lower, upper)
        if not self.settings.levels[-1].is_judged:  # where the last step led to
            found, _, look = self._moved(target, values, reference, expected, self.settings.levels[-1])
            ended = self._ended(target, found, reference, look)
            kept = ended if kept is None else kept.or_better(ended)
        assert kept is not None
        return self._finished(kept, start, iterations)

    def _moved(
        self, target: HullTarget, values: Tensor, reference: Tensor, expected: Expectation | None, level: HullLevel
    ) -> tuple[LeastSquares, Tensor, HullLook]:
        """What was found about some values, the values to go on with, and the look at the model there."""
        lower, upper = self._bounds
        look = self.look(target, self._pose(values), reference, expected, level)
        if level.is_judged:
            newton = LevenbergMarquardtSettings(
                iterations=level.iterations,
                damping=_DAMPING,
                cost_tolerance=_COST_TOLERANCE,
                step_tolerance=_STEP_TOLERANCE,
            )
            found = levenberg_marquardt(
                look.cost.equations, values, lower=lower, upper=upper, settings=newton, takes_rows=True
            )
            return found, found.values, look
        here = look.cost.equations(values, torch.arange(len(values), device=values.device), look.bones)
        damping = torch.full_like(here.cost, _DAMPING)
        step, is_solved = damped_box_step(here.matrix, here.gradient, damping, lower - values, upper - values)
        is_sound = is_solved & here.cost.isfinite() & step.isfinite().all(-1)
        is_there = -0.5 * (here.gradient * step).sum(-1) <= _ARRIVED * here.cost
        status = torch.where(is_there, Status.CONVERGED.value, Status.STALLED.value)
        found = LeastSquares(
            values=values,
            cost=here.cost,
            status=torch.where(is_sound, status, Status.FAILED.value),
            iterations=torch.ones(len(values), dtype=torch.long, device=values.device),
            matrix=here.matrix,
            gradient=here.gradient,
            on_bound=(values <= lower) | (values >= upper),
        )
        return found, torch.where(is_sound[:, None], values + step, values), look

    def _pose(self, values: Tensor) -> Tensor:
        return clamp_to_limits(self.beliefs.space.dof(values), self.skin.hand.kinematics.skeleton)

    def _free(self, pose: Tensor) -> Tensor:
        return (pose - self.beliefs.space.constant) @ self._inverse.T

    def look(
        self,
        target: HullTarget,
        pose: Float[Tensor, "k 36"],
        reference: Float[Tensor, "k 3 3"],
        expected: Expectation | None,
        level: HullLevel,
    ) -> HullLook:
        """The model in some poses, and the cost about them."""
        settings, like = self.settings, self.skin.shape
        bones = self.skin.posed(pose.to(like), reference.to(like))
        skin = self.skin.skin_on(bones)
        seen = self._seen(target, skin, bones)
        inside, share, firm, beyond = self._inside, self._share, self._firm[self.vertices], None
        if not level.is_judged:
            beyond = target.field.sample(skin[:, self.vertices])[0]
            if len(pose) == 1:  # asked nowhere else: what is within the hull there costs nothing
                is_outside = beyond[0] > settings.slack_m
                inside, share = self.skin.loads(self.vertices[is_outside]), share[is_outside]
                firm = firm[is_outside]
        precision = max(settings.std_m, settings.std_share * level.robust_m) ** -2
        count = seen.is_hand.sum(-1, keepdim=True).clamp_min(1)
        weight = settings.surface_weight if target.rims is None else settings.covered_weight
        held = HeldHull(
            root_reference=reference,
            match=self.skin.loads(seen.match),
            points=seen.points,
            normals=seen.normals,
            covered_weight=weight * precision / count * seen.is_hand * self._firm[seen.match],
            beliefs=self.beliefs.held(pose, None if expected is None else expected.about(reference, self._columns)),
        )
        cost = HullCost(
            skin=self.skin,
            beliefs=self.beliefs,
            held=held,
            target=target,
            inside=inside,
            inside_weight=settings.inside_weight * precision * share * firm,
            inside_robust=RobustLoss(kind="huber", scale=settings.inside_robust * precision**-0.5),
            covered_robust=RobustLoss(kind="geman_mcclure", scale=level.robust_m),
            slack_m=settings.slack_m,
        )
        return HullLook(cost=cost, bones=bones, seen=seen, beyond=beyond)

    def _seen(self, target: HullTarget, vertices: Tensor, bones: PosedBones) -> SeenHull:
        skin_normals, turn = self.skin.normals(vertices), self.settings.turn_m
        if target.rims is None:
            points, outward = target.points.to(vertices), target.normals.to(vertices)
            match = match_hull(points, outward, vertices, skin_normals, turn=turn)
            index = match[..., None].expand(-1, -1, 3)
            normals, place = skin_normals.gather(1, index), vertices.gather(1, index)
            near = points
        else:
            points = target.rims.points.to(vertices)
            match = target.rims.match(vertices, skin_normals, turn=turn)
            place = vertices.gather(1, match[..., None].expand(-1, -1, 3))
            normals = target.rims.normals.to(vertices).expand_as(place)
            near = target.rims.near(place)
        across = (normals * (place - near)).sum(-1).abs()
        beside = ((place - near).square().sum(-1) - across.square()).clamp_min(0).sqrt()
        height = ((near - bones.position[:, :1]) * bones.rotation[:, :1, :, 1]).sum(-1)
        return SeenHull(
            match=match,
            points=points,
            normals=normals,
            apart=torch.where(beside > _BESIDE, torch.inf, across),
            is_hand=(height > -self.settings.beyond_wrist_m).to(vertices),
        )

    def _ended(self, target: HullTarget, found: LeastSquares, reference: Tensor, look: HullLook | None) -> EndedFits:
        """look: at the values that were found, where there is one."""
        pose, reference = rebased(self._pose(found.values), reference)
        if look is None or look.beyond is None:
            bones = self.skin.posed(pose.to(self.skin.shape), reference.to(self.skin.shape))
            vertices = self.skin.skin_on(bones)
            beyond, seen = target.field.sample(vertices[:, self.vertices])[0], self._seen(target, vertices, bones)
        else:
            beyond, seen = look.beyond, look.seen
        most, near = self.settings.levels[-1].robust_m, self.settings.near_m
        count = seen.is_hand.sum(-1).clamp_min(1)
        is_sound = (found.status != Status.FAILED.value) & pose.isfinite().all(-1)
        return EndedFits(
            pose=pose,
            reference=reference,
            cost=torch.where(is_sound, found.cost, torch.inf),
            status=torch.where(is_sound, found.status, Status.FAILED.value),
            matrix=found.matrix,
            inside=((beyond <= self.settings.slack_m) * self._share).sum(-1).to(pose),
            held=((beyond <= near) * self._share).sum(-1).to(pose),
            apart=((seen.apart.clamp_max(most) * seen.is_hand).sum(-1) / count).to(pose),
            covered=(((seen.apart <= near) * seen.is_hand).sum(-1) / count).to(pose),
        )

    def _finished(self, kept: EndedFits, start: tuple[Tensor, Tensor], iterations: Tensor) -> HullFit:
        failed = kept.status == Status.FAILED.value
        is_good = (kept.covered >= self.settings.least_covered) & (kept.held >= self.settings.least_held)
        return HullFit(
            pose=torch.where(failed[:, None], start[0], kept.pose),
            root_reference=torch.where(failed[:, None, None], start[1], kept.reference),
            cost=kept.cost,
            inside_share=torch.where(failed, torch.nan, kept.inside),
            apart_m=torch.where(failed, torch.inf, kept.apart),
            covered_share=torch.where(failed, 0.0, kept.covered),
            is_good=is_good & ~failed,
            status=kept.status,
            iterations=iterations,
            covariance=covariance_of(kept.matrix, ~failed),
        )

    def _unmoved(self, pose: Tensor, reference: Tensor, status: HullStatus) -> HullFit:
        size, count = self.beliefs.space.size, len(pose)
        nothing = torch.full((count,), torch.inf, dtype=pose.dtype, device=pose.device)
        zeros = torch.zeros(count, dtype=torch.long, device=pose.device)
        return HullFit(
            pose=pose,
            root_reference=reference,
            cost=nothing,
            inside_share=torch.full_like(nothing, torch.nan),
            apart_m=nothing.clone(),
            covered_share=torch.zeros_like(nothing),
            is_good=torch.zeros_like(nothing, dtype=torch.bool),
            status=zeros + status.value,
            iterations=zeros,
            covariance=torch.full((count, size, size), torch.nan, dtype=pose.dtype, device=pose.device),
        )
