"""The proportions of one hand fitted to the hulls of several frames at once, together with its pose in each.

Nothing but the shape is common to the frames, and all are solved as one problem: a bone that is too short is only told
from a joint that is bent by the frames in which it is not. What is known of people's hands holds what the hulls do not
tell. To be done once per user, so correctness comes before speed.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.fit import PostureResiduals, free_bounds, weighted_equations
from torchhand.fit.hull.cost import HullCost
from torchhand.fit.hull.fit import HullFitter
from torchhand.fit.hull.points import HullTarget
from torchhand.fit.hull.settings import HullFitSettings, HullLevel, HullShapeSettings
from torchhand.fit.hull.shape_rows import people_rows, shape_rows
from torchhand.fit.hull.skin import SkinPoints
from torchhand.hand import Anthropometry, Hand, PoseConstraints, PoseSpace, rebased
from torchhand.hand.limits import clamp_to_limits
from torchhand.numerics import LevenbergMarquardtSettings, NormalEquations, levenberg_marquardt

_ROOT = 6


@dataclass(frozen=True, kw_only=True)
class HullShapeFit:
    """One shape, and the poses that go with it."""

    shape: Float[Tensor, "shape"]
    """Within the bounds and the anthropometric constraints."""
    shape_std: Float[Tensor, "shape"]
    """Standard deviation of each parameter, by the curvature of the cost."""
    pose: Float[Tensor, "frames 36"]
    """With zero rotation vectors, within the limits."""
    root_reference: Float[Tensor, "frames 3 3"]
    cost: float
    """At the last look, of all frames together."""


def fit_shape(
    targets: Sequence[HullTarget],
    hand: Hand,
    space: PoseSpace,
    pose: Float[Tensor, "frames 36"],
    root_reference: Float[Tensor, "frames 3 3"],
    people: Anthropometry,
    settings: HullShapeSettings | None = None,
    fit: HullFitSettings | None = None,
    *,
    shape: Float[Tensor, "shape"] | None = None,
    constraints: PoseConstraints | None = None,
    prior: PostureResiduals | None = None,
) -> HullShapeFit:
    """Shape and poses from fits of the poses with some shape.

    targets: the hulls of the frames, none empty, with the edges of their silhouettes (`with_rims`): fitted to the
    surface alone, the palm grows into what of a hull no hand fills. Leave out frames whose start is not good. hand: in
    float64; shape: to start from, the hand's own where it is None. people: the anthropometric prior. fit: sizes and
    weights as for the poses alone; its levels do not count.

    Raises ValueError where the numbers of hulls and poses differ or a hull is empty.
    """
    settings, fit = settings or HullShapeSettings(), fit or HullFitSettings()
    if not len(targets) == len(pose) == len(root_reference) or not len(pose):
        raise ValueError(f"targets: expected as many as poses, at least one, got {len(targets)} and {len(pose)}")
    if any(target.is_empty for target in targets):
        raise ValueError("targets: expected a hull in every frame")
    shape = (hand.shape if shape is None else shape).clone()
    with torch.inference_mode():
        pose, reference = rebased(pose.to(space.basis), root_reference.to(space.basis))
        free = space.free(pose)
        matrix = cost = None
        for turn in range(settings.rounds):
            share = turn / max(1, settings.rounds - 1)
            first, last = settings.robust_m
            level = HullLevel(robust_m=first * (last / first) ** share)
            fitter = HullFitter(hand, space, fit, shape=shape, constraints=constraints, prior=prior)
            problem = _Problem.look(fitter, targets, free, reference, people, settings, level)
            newton = LevenbergMarquardtSettings(iterations=settings.iterations, damping=1e-2, cost_tolerance=1e-4)
            start = torch.cat((free.flatten(), problem.scaled(shape)))
            lower, upper = problem.bounds
            found = levenberg_marquardt(
                problem.equations, start.clamp(lower, upper), lower=lower, upper=upper, settings=newton
            )
            free, shape = problem.split(found.values)
            moved, reference = rebased(problem.pose(free), reference)
            free, matrix, cost = space.own(moved), found.matrix, found.cost
        assert matrix is not None
        assert cost is not None
        inverse = torch.linalg.inv(matrix + 1e-9 * torch.diag(matrix.diagonal()))
        std = inverse.diagonal()[free.numel() :].clamp_min(0).sqrt() * people.space.std.to(shape)
    return HullShapeFit(
        shape=people.project(shape),
        shape_std=std,
        pose=clamp_to_limits(space.dof(free), hand.kinematics.skeleton),
        root_reference=reference,
        cost=float(cost),
    )


@dataclass(frozen=True, kw_only=True)
class _Problem:
    """All frames between two looks; the values are the free parameters frame by frame, then the shape in spreads."""

    fitter: HullFitter
    targets: Sequence[HullTarget]
    reference: Float[Tensor, "frames 3 3"]
    people: Anthropometry
    people_weight: float
    looks: list[HullCost]
    """Of every frame."""
    matches: list[Int[Tensor, "_hull"]]

    @classmethod
    def look(
        cls,
        fitter: HullFitter,
        targets: Sequence[HullTarget],
        free: Tensor,
        reference: Tensor,
        people: Anthropometry,
        settings: HullShapeSettings,
        level: HullLevel,
    ) -> "_Problem":
        pose = clamp_to_limits(fitter.beliefs.space.dof(free), fitter.skin.hand.kinematics.skeleton)
        looks, matches = [], []
        for index, target in enumerate(targets):
            look = fitter.look(target, pose[index : index + 1], reference[index : index + 1], None, level)
            looks.append(look.cost)
            matches.append(look.seen.match[0])
        return cls(
            fitter=fitter,
            targets=targets,
            reference=reference,
            people=people,
            people_weight=settings.people_weight,
            looks=looks,
            matches=matches,
        )

    @property
    def _size(self) -> int:
        return self.fitter.beliefs.space.size

    @property
    def bounds(self) -> tuple[Tensor, Tensor]:
        space, people = self.fitter.beliefs.space, self.people.space
        count = len(self.targets)
        ends = zip(
            free_bounds(space, self.fitter.skin.hand.kinematics.skeleton), (people.lower, people.upper), strict=True
        )
        lower, upper = (torch.cat((own.repeat(count), self.scaled(end.to(own)))) for own, end in ends)
        return lower, upper

    def scaled(self, shape: Float[Tensor, "shape"]) -> Float[Tensor, "shape"]:
        return (shape - self.people.space.default.to(shape)) / self.people.space.std.to(shape)

    def split(self, values: Float[Tensor, "n"]) -> tuple[Float[Tensor, "frames free"], Float[Tensor, "shape"]]:
        count = len(self.targets) * self._size
        space = self.people.space
        shape = values[count:] * space.std.to(values) + space.default.to(values)
        return values[:count].unflatten(0, (-1, self._size)), shape

    def pose(self, free: Float[Tensor, "frames free"]) -> Float[Tensor, "frames 36"]:
        return clamp_to_limits(self.fitter.beliefs.space.dof(free), self.fitter.skin.hand.kinematics.skeleton)

    def equations(self, values: Float[Tensor, "n"]) -> NormalEquations:
        free, shape = self.split(values)
        hand, space, beliefs = self.fitter.skin.hand, self.fitter.beliefs.space, self.fitter.beliefs
        size, count = self._size, len(self.targets)
        skin = SkinPoints(hand, space.basis, shape)
        spread = self.people.space.std.to(shape)
        matrix = values.new_zeros(len(values), len(values))
        gradient, total = torch.zeros_like(values), values.new_zeros(())
        common = torch.arange(count * size, len(values))
        for index, (target, look, match) in enumerate(zip(self.targets, self.looks, self.matches, strict=True)):
            wanted = space.dof(free[index])[None]
            pose = clamp_to_limits(wanted, hand.kinematics.skeleton)
            reference = self.reference[index : index + 1]
            vertices = torch.cat((self.fitter.vertices, match))
            motion = skin.motion(pose, reference, skin.loads(vertices), pose == wanted)
            inside = len(self.fitter.vertices)
            value, slope = target.field.sample(motion.points[:, :inside])
            over = (value - look.slack_m).clamp_min(0)
            directions = torch.cat(((over > 0)[..., None] * slope, look.held.normals), 1)
            apart = (look.held.normals * (motion.points[:, inside:] - look.held.points)).sum(-1)
            of_shape = shape_rows(hand, pose[0], reference[0], shape, vertices, directions[0], spread)
            rows = torch.cat((motion.along(directions)[0], of_shape), 1)
            terms = [
                weighted_equations(over[0], rows[:inside], look.inside_weight, look.inside_robust),
                weighted_equations(apart[0], rows[inside:], look.held.covered_weight[0], look.covered_robust),
            ]
            here = torch.cat((torch.arange(index * size, (index + 1) * size), common))
            for term in terms:
                matrix[here[:, None], here] += term.matrix
                gradient[here] += term.gradient
                total = total + term.cost
            joints = beliefs.of_joints(pose, look.held.beliefs)
            if joints is not None:
                basis = (pose == wanted)[0, _ROOT:, None] * space.basis[_ROOT:]
                own = here[:size]
                matrix[own[:, None], own] += basis.T @ joints.matrix[0] @ basis
                gradient[own] += joints.gradient[0] @ basis
                total = total + joints.cost[0]
        residual, rows = people_rows(self.people, shape)
        own = weighted_equations(residual, rows, residual.new_full(residual.shape, self.people_weight))
        matrix[common[:, None], common] += own.matrix
        gradient[common] += own.gradient
        return NormalEquations(matrix=matrix, gradient=gradient, cost=total + own.cost)
