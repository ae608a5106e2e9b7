"""Levenberg-Marquardt for one problem of many blocks and some unknowns that all of them share: an arrow of equations.

The blocks are eliminated from the normal equations (Schur complement), so that the cost of a step grows with their
number and not with its cube (Triggs et al. 2000, section 6).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Shaped
from torch import Tensor

from torchhand.numerics.least_squares.records import LevenbergMarquardtSettings, Status

_PASSES = 3  # after them, what still leads out of the box is cut off
_LEAST_DIAGONAL = 1e-12  # of the largest entry of the diagonal: an unknown without any influence stays solvable
_ACCEPTED_SHARE = 1e-4  # of the predicted decrease
_GOOD_SHARE, _POOR_SHARE = 0.75, 0.25
_LOOSEN, _KEEP, _TIGHTEN, _REFUSED = 0.1, 0.5, 2.0, 4.0
_LEAST_DAMPING = 1e-12
_ROUNDING = 8.0  # tolerances below this many units of rounding mean nothing


@dataclass(frozen=True, kw_only=True)
class ArrowEquations:
    """A cost and its quadratic model in the unknowns of f blocks and c shared ones."""

    blocks: Float[Tensor, "f n n"]
    """Second derivative in the unknowns of each block."""
    mixed: Float[Tensor, "f n c"]
    shared: Float[Tensor, "c c"]
    block_gradient: Float[Tensor, "f n"]
    shared_gradient: Float[Tensor, "c"]
    cost: Float[Tensor, ""]

    @property
    def is_finite(self) -> bool:
        sums = (self.blocks, self.mixed, self.shared, self.block_gradient, self.shared_gradient, self.cost)
        return bool(torch.stack([part.sum() for part in sums]).isfinite().all())

    def eliminated(self) -> tuple[Float[Tensor, "c c"], Float[Tensor, "c"], Float[Tensor, "f n c+1"]]:
        """Matrix and gradient of the shared unknowns once every block has followed them, and how blocks follow.

        The last part solves blocks · x = (mixed, block gradient): a block's step is -x (shared step, 1).
        """
        factor, info = torch.linalg.cholesky_ex(self.blocks)
        right = torch.cat((self.mixed, self.block_gradient[..., None]), -1)
        solved = torch.where((info == 0)[:, None, None], torch.cholesky_solve(right, factor), 0.0)
        correction = self.mixed.flatten(0, 1).mT @ solved.flatten(0, 1)
        matrix = self.shared - correction[:, :-1]
        return 0.5 * (matrix + matrix.mT), self.shared_gradient - correction[:, -1], solved


@dataclass(frozen=True, kw_only=True)
class ArrowValues:
    """Values, steps or bounds of all unknowns."""

    blocks: Shaped[Tensor, "f n"]
    shared: Shaped[Tensor, "c"]

    def map(self, function: Callable[..., Tensor], *others: "ArrowValues") -> "ArrowValues":
        """The function of both parts, with those of others."""
        return ArrowValues(
            blocks=function(self.blocks, *(other.blocks for other in others)),
            shared=function(self.shared, *(other.shared for other in others)),
        )

    def any(self) -> bool:
        return bool(self.blocks.any()) or bool(self.shared.any())

    def norm(self) -> Float[Tensor, ""]:
        return (self.blocks.square().sum() + self.shared.square().sum()).sqrt()


@dataclass(frozen=True, kw_only=True)
class ArrowSolution:
    """Where the optimiser ended."""

    values: ArrowValues
    """The best found, within the bounds."""
    equations: ArrowEquations
    """At the values."""
    status: Status
    iterations: int
    """Evaluations after that at the start."""


@torch.no_grad()
def arrow_levenberg_marquardt(
    linearise: Callable[[ArrowValues], ArrowEquations],
    start: ArrowValues,
    lower: ArrowValues,
    upper: ArrowValues,
    settings: LevenbergMarquardtSettings,
) -> ArrowSolution:
    """Minimise a cost over all unknowns with lower <= values <= upper; bounds may be infinite.

    As `levenberg_marquardt`: Marquardt's damping, steps are taken only if they lower the cost, the start is put into
    the bounds.
    """
    values = start.map(torch.clamp, lower, upper)
    here = linearise(values)
    damping, factor, iterations = settings.damping, _REFUSED, 0
    if not here.is_finite:
        return ArrowSolution(values=values, equations=here, status=Status.FAILED, iterations=0)
    status, rounding = Status.STALLED, _ROUNDING * torch.finfo(here.cost.dtype).eps
    for _ in range(settings.iterations):
        rooms = (lower.map(torch.sub, values), upper.map(torch.sub, values))
        step = damped_arrow_step(here, damping, *rooms)
        promised = _promised(here, step)
        is_small = float(step.norm()) <= max(settings.step_tolerance, rounding) * float(values.norm())
        is_small |= promised <= max(settings.cost_tolerance, rounding) * float(here.cost)
        if (is_small and damping <= 1) or not float(step.norm()) or float(here.cost) <= settings.cost_floor:
            status = Status.CONVERGED
            break
        if damping > settings.most_damping:
            break
        trial = values.map(torch.add, step).map(torch.clamp, lower, upper)
        found = linearise(trial)
        iterations += 1
        share = (float(here.cost) - float(found.cost)) / promised
        if found.is_finite and float(found.cost) < float(here.cost) and share >= _ACCEPTED_SHARE:
            values, here, factor = trial, found, _REFUSED
            change = _LOOSEN if share > _GOOD_SHARE else _KEEP if share > _POOR_SHARE else _TIGHTEN
        else:
            change, factor = factor, 2 * factor
        damping = max(damping * change, _LEAST_DAMPING)
    return ArrowSolution(values=values, equations=here, status=status, iterations=iterations)


def damped_arrow_step(
    equations: ArrowEquations, damping: float, room_below: ArrowValues, room_above: ArrowValues
) -> ArrowValues:
    """The step of a quadratic model with damping · diagonal added, room_below <= step <= room_above.

    As `damped_box_step`: unknowns on a bound that are driven against it are frozen, those that the others carry beyond
    one are put onto it and the others solved once more.
    """
    damped = replace(equations, blocks=_damped(equations.blocks, damping), shared=_damped(equations.shared, damping))
    gradient = ArrowValues(blocks=equations.block_gradient, shared=equations.shared_gradient)
    pinned = room_below.map(
        lambda below, above, slope: ((below >= 0) & (slope > 0)) | ((above <= 0) & (slope < 0)), room_above, gradient
    )
    held = gradient.map(torch.zeros_like)
    step = _solved_with_pinned(damped, pinned, held)
    for _ in range(_PASSES):
        leads_out = step.map(lambda own, below, above: (own < below) | (own > above), room_below, room_above)
        if not leads_out.any():
            return step
        pinned = pinned.map(torch.logical_or, leads_out)
        held = step.map(
            lambda own, is_pinned, below, above: torch.where(is_pinned, own.clamp(below, above), 0.0),
            pinned,
            room_below,
            room_above,
        )
        step = _solved_with_pinned(damped, pinned, held)
    return step.map(torch.clamp, room_below, room_above)


def _damped(matrix: Float[Tensor, "*f n n"], damping: float) -> Float[Tensor, "*f n n"]:
    diagonal = matrix.diagonal(dim1=-2, dim2=-1)
    if not diagonal.shape[-1]:
        return matrix
    least = _LEAST_DIAGONAL * diagonal.amax(-1, keepdim=True) + torch.finfo(matrix.dtype).tiny
    return matrix + (damping * torch.maximum(diagonal, least) + least).diag_embed()


def _solved_with_pinned(equations: ArrowEquations, pinned: ArrowValues, held: ArrowValues) -> ArrowValues:
    """The step whose pinned entries are those of `held` and whose others solve the rest."""
    moved_blocks = (equations.blocks @ held.blocks[..., None]).squeeze(-1) + equations.mixed @ held.shared
    moved_shared = equations.shared @ held.shared + torch.einsum("fnc,fn->c", equations.mixed, held.blocks)
    open_blocks, open_shared = (_is_open(part, equations) for part in (pinned.blocks, pinned.shared))
    blocks = equations.blocks * open_blocks[..., :, None] * open_blocks[..., None, :]
    shared = equations.shared * open_shared[:, None] * open_shared
    reduced = ArrowEquations(
        blocks=blocks + (1 - open_blocks).diag_embed(),
        mixed=equations.mixed * open_blocks[..., None] * open_shared,
        shared=shared + (1 - open_shared).diag_embed(),
        block_gradient=(equations.block_gradient + moved_blocks) * open_blocks,
        shared_gradient=(equations.shared_gradient + moved_shared) * open_shared,
        cost=equations.cost,
    )
    matrix, gradient, solved = reduced.eliminated()
    root, info = torch.linalg.cholesky_ex(matrix)
    step = -torch.cholesky_solve(gradient[:, None], root).squeeze(-1) if int(info) == 0 else torch.zeros_like(gradient)
    of_blocks = -(solved[..., :-1] @ step) - solved[..., -1]
    return ArrowValues(
        blocks=torch.where(pinned.blocks, held.blocks, of_blocks), shared=torch.where(pinned.shared, held.shared, step)
    )


def _is_open(pinned: Bool[Tensor, "*f n"], equations: ArrowEquations) -> Float[Tensor, "*f n"]:
    return (~pinned).to(equations.blocks)


def _promised(equations: ArrowEquations, step: ArrowValues) -> float:
    """Decrease of the cost that the quadratic model predicts."""
    bent_blocks = (equations.blocks @ step.blocks[..., None]).squeeze(-1) + 2 * (equations.mixed @ step.shared)
    quadratic = (step.blocks * bent_blocks).sum() + step.shared @ equations.shared @ step.shared
    linear = (equations.block_gradient * step.blocks).sum() + equations.shared_gradient @ step.shared
    return -float(linear + 0.5 * quadratic)
