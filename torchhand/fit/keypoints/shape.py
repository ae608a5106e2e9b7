"""What all frames share (shape, scale, offsets), fitted to all of them at once."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.fit.keypoints.residuals import Blocks, Common, KeypointCost
from torchhand.hand import Anthropometry, ShapeSpace, moving_parameters
from torchhand.numerics import LeastSquares, LevenbergMarquardtSettings, NormalEquations, levenberg_marquardt

_LOG_SCALE_STD = 3.0  # as good as nothing known
_SOFTNESS = 0.025  # violation of an anthropometric constraint that costs ½, in its spread over people
_FEW = 6  # iterations on the poses for each look at the shape; the next look goes on from there


@dataclass(frozen=True, kw_only=True)
class CommonParameters:
    """The free ones among what all frames share, as one vector about a start."""

    columns: tuple[int, ...]
    """Shape parameters that are free, index into the shape space's names."""
    start: Common
    has_scale: bool
    has_offsets: bool
    mean: Float[Tensor, "k"]
    std: Float[Tensor, "k"]
    """Spread of the belief in the mean."""
    lower: Float[Tensor, "k"]
    upper: Float[Tensor, "k"]

    @classmethod
    def of(
        cls,
        space: ShapeSpace,
        columns: Sequence[int],
        start: Common,
        *,
        has_scale: bool,
        offset_std: float,
        constraints: Anthropometry | None,
    ) -> "CommonParameters":
        """Shape parameters are believed to be the population's: mean and spread of the shape space. Their bounds are
        its own, and those constraints that concern a single parameter."""
        like, chosen = start.shape, list(columns)
        has_offsets = offset_std > 0
        mean, std = [space.default.to(like)[chosen]], [space.std.to(like)[chosen]]
        least, most = (space.lower, space.upper) if constraints is None else _box(constraints)
        lower, upper = [least.to(like)[chosen]], [most.to(like)[chosen]]
        if has_scale:
            mean.append(start.log_scale.reshape(1))
            std.append(like.new_tensor([_LOG_SCALE_STD]))
        if has_offsets:
            mean.append(like.new_zeros(63))
            std.append(like.new_full((63,), offset_std))
        unbounded = like.new_full((len(torch.cat(mean)) - len(chosen),), torch.inf)
        return cls(
            columns=tuple(columns),
            start=start,
            has_scale=has_scale,
            has_offsets=has_offsets,
            mean=torch.cat(mean),
            std=torch.cat(std),
            lower=torch.cat((*lower, -unbounded)),
            upper=torch.cat((*upper, unbounded)),
        )

    @property
    def size(self) -> int:
        return len(self.mean)

    def vector(self, common: Common) -> Float[Tensor, "k"]:
        parts = [common.shape[list(self.columns)]]
        parts += [common.log_scale.reshape(1)] if self.has_scale else []
        parts += [common.offsets.flatten()] if self.has_offsets else []
        return torch.cat(parts)

    def common(self, vector: Float[Tensor, "k"]) -> Common:
        count = len(self.columns)
        chosen = torch.tensor(self.columns, dtype=torch.int64, device=vector.device)
        common = replace(self.start, shape=self.start.shape.index_copy(0, chosen, vector[:count]))
        if self.has_scale:
            common = replace(common, log_scale=vector[count])
        return replace(common, offsets=vector[-63:].unflatten(0, (21, 3))) if self.has_offsets else common


def _box(constraints: Anthropometry) -> tuple[Tensor, Tensor]:
    """The tightest bounds among the inequalities matrix · shape <= bound that concern one parameter."""
    lower, upper = constraints.space.lower.clone(), constraints.space.upper.clone()
    for row, bound in zip(constraints.matrix, constraints.bound, strict=True):
        (places,) = row.nonzero(as_tuple=True)
        if len(places) == 1:
            limit, place = bound / row[places[0]], places[0]
            if row[place] > 0:
                upper[place] = torch.minimum(upper[place], limit)
            else:
                lower[place] = torch.maximum(lower[place], limit)
    return lower, upper


@dataclass(frozen=True, kw_only=True)
class Reduced:
    """The common parameters' normal equations once every pose has followed them (Schur complement)."""

    equations: NormalEquations
    follow: Float[Tensor, "frames n k"]
    """How the best poses change with the common parameters."""


def reduced(
    blocks: Blocks, lower: Float[Tensor, "n"], upper: Float[Tensor, "n"], free: Float[Tensor, "frames n"]
) -> Reduced:
    """Poses eliminated from an arrow of normal equations; angles that their limits hold do not follow."""
    held = (free <= lower) & (blocks.pose_gradient > 0) | (free >= upper) & (blocks.pose_gradient < 0)
    is_open = (~held).to(free)
    pose = blocks.pose * is_open[:, :, None] * is_open[:, None, :]
    diagonal = pose.diagonal(dim1=-2, dim2=-1)
    diagonal += (1 - is_open) + 1e-12 * diagonal.amax(-1, keepdim=True)
    mixed = blocks.mixed * is_open[..., None]
    factor, info = torch.linalg.cholesky_ex(pose)
    solved = torch.cholesky_solve(torch.cat((mixed, (is_open * blocks.pose_gradient)[..., None]), -1), factor)
    solved = torch.where((info == 0)[:, None, None], solved, 0.0)
    flat = mixed.flatten(0, 1)
    correction = flat.mT @ solved.flatten(0, 1)
    matrix = blocks.common - correction[:, :-1]
    return Reduced(
        equations=NormalEquations(
            matrix=0.5 * (matrix + matrix.mT),
            gradient=blocks.common_gradient - correction[:, -1],
            cost=blocks.cost,
        ),
        follow=-solved[..., :-1],
    )


@dataclass(kw_only=True)
class CommonFit:
    """Levenberg-Marquardt over the common parameters; the cost of each trial is that of the poses best for it.

    This descends on the joint cost of all poses and common parameters, and ends in a minimum of it: at the best poses
    the derivative of their cost with the common parameters is the partial one, and the Schur complement of the joint
    normal equations is its second derivative as far as Gauss-Newton knows it.
    """

    cost: KeypointCost
    parameters: CommonParameters
    lower: Float[Tensor, "n"]
    upper: Float[Tensor, "n"]
    free: Float[Tensor, "frames n"]
    """Poses that go with the best common parameters so far."""
    pose_settings: LevenbergMarquardtSettings
    constraints: Anthropometry | None
    """Published intervals that the shape keeps; None for none."""

    def solve(self, start: Common, settings: LevenbergMarquardtSettings) -> tuple[Common, LeastSquares]:
        """Moves `free` along. Every frame must have a finite cost at the start."""
        self._rows = torch.arange(len(self.free), device=self.free.device)
        self._best = torch.inf
        self._here = self.parameters.vector(start)
        self._follow: Tensor | None = None
        found = levenberg_marquardt(
            self._linearise, self._here, lower=self.parameters.lower, upper=self.parameters.upper, settings=settings
        )
        common = self.parameters.common(found.values)
        if self.constraints is not None and self.parameters.columns:
            # Parameters that move no keypoint may give way too.
            held = set(moving_parameters(self.cost.kinematics)) - set(self.parameters.columns)
            projected = self.constraints.project(common.shape)
            projected[list(held)] = common.shape[list(held)]
            common = replace(common, shape=projected)
        return common, found

    def _linearise(self, vector: Tensor) -> NormalEquations:
        common = self.parameters.common(vector)
        start = self.free
        if self._follow is not None:
            start = (start + self._follow @ (vector - self._here)).clamp(self.lower, self.upper)
        found = levenberg_marquardt(
            lambda free, rows: self.cost.pose_equations(free, rows, common),
            start,
            lower=self.lower,
            upper=self.upper,
            settings=replace(self.pose_settings, iterations=_FEW),
            takes_rows=True,
        )
        blocks = self.cost.blocks(found.values, self._rows, common)
        eliminated = reduced(blocks, self.lower, self.upper, found.values)
        away = (vector - self.parameters.mean) / self.parameters.std
        wall, wall_gradient, wall_matrix = self._wall(common)
        equations = eliminated.equations
        total = equations.cost + 0.5 * away.square().sum() + wall
        if float(total) < self._best:
            self._best, self._here, self.free, self._follow = float(total), vector, found.values, eliminated.follow
        return NormalEquations(
            matrix=equations.matrix + torch.diag(self.parameters.std**-2) + wall_matrix,
            gradient=equations.gradient + away / self.parameters.std + wall_gradient,
            cost=total,
        )

    def _wall(self, common: Common) -> tuple[Tensor, Tensor, Tensor]:
        """Cost of violated anthropometric constraints, with its derivatives; piecewise quadratic."""
        size, columns = self.parameters.size, list(self.parameters.columns)
        gradient, matrix = common.shape.new_zeros(size), common.shape.new_zeros(size, size)
        if self.constraints is None or not columns:
            return gradient.sum(), gradient, matrix
        rows, bound = self.constraints.matrix.to(gradient), self.constraints.bound.to(gradient)
        spread = (rows * self.constraints.space.std.to(gradient)).norm(dim=-1)
        excess = (rows @ common.shape - bound).clamp_min(0) / (_SOFTNESS * spread)
        active = (excess > 0)[:, None] * rows[:, columns] / (_SOFTNESS * spread)[:, None]
        gradient[: len(columns)] = active.T @ excess
        matrix[: len(columns), : len(columns)] = active.T @ active
        return 0.5 * excess.square().sum(), gradient, matrix
