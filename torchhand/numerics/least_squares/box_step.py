"""The damped Gauss-Newton step inside a box, for many problems at once."""

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.devices import is_host, may_hold
from torchhand.precision import full_precision

_PASSES = 3  # after them, what still leads out of the box is cut off
_MIN_DIAGONAL = 1e-12  # of the largest entry of the diagonal: a variable without any influence stays solvable


@full_precision
def damped_box_step(
    matrix: Float[Tensor, "k n n"],
    gradient: Float[Tensor, "k n"],
    damping: Float[Tensor, "k"],
    room_below: Float[Tensor, "k n"] | None,
    room_above: Float[Tensor, "k n"] | None,
) -> tuple[Float[Tensor, "k n"], Bool[Tensor, "k"]]:
    """Step d that lowers gradient · d + ½ dᵀ(matrix + damping · diag)d with room_below <= d <= room_above.

    A variable that lies on a bound and is driven against it is frozen. Variables that the step of the others carries
    beyond a bound are put onto it and the others solved once more, a few times; this is not always the exact minimum
    in the box, but with growing damping it turns into the projected gradient step, which descends. The rooms (distances
    to the bounds, below <= 0 <= above) may be infinite; None stands for no bounds. The second result tells where the
    matrix could be factored; elsewhere the step is 0.
    """
    diagonal = matrix.diagonal(dim1=-2, dim2=-1)
    minimum = _MIN_DIAGONAL * diagonal.amax(-1, keepdim=True) + torch.finfo(matrix.dtype).tiny
    damped = matrix + (damping[:, None] * torch.maximum(diagonal, minimum) + minimum).diag_embed()
    if room_below is None or room_above is None:
        return _solved(damped, -gradient)
    pinned = ((room_below >= 0) & (gradient > 0)) | ((room_above <= 0) & (gradient < 0))
    step, is_solved = _solved_with_pinned(damped, gradient, pinned, torch.zeros_like(gradient))
    leads_out = (step < room_below) | (step > room_above)
    for _ in range(_PASSES):
        if not may_hold(leads_out):
            return step, is_solved
        pinned = pinned | leads_out
        again = _rows_with(leads_out)
        pinned_step = torch.where(pinned[again], step[again].clamp(room_below[again], room_above[again]), 0.0)
        solved, is_fine = _solved_with_pinned(damped[again], gradient[again], pinned[again], pinned_step)
        is_out = leads_out[again].any(-1)
        step[again] = torch.where(is_out[:, None], solved, step[again])
        is_solved[again] = is_solved[again] & (is_fine | ~is_out)
        leads_out = (step < room_below) | (step > room_above)
    return step.clamp(room_below, room_above), is_solved


def after_box_step(
    values: Float[Tensor, "*batch n"],
    step: Float[Tensor, "*batch n"],
    low: Float[Tensor, "*#batch n"],
    high: Float[Tensor, "*#batch n"],
) -> Float[Tensor, "*batch n"]:
    """Values after a step within their rooms. Those that the step leads to a bound lie on it: a sum that is rounded
    would lie a last bit beside it, inside, where they are free to move, or outside."""
    trial = torch.where(step <= low - values, low, values + step)
    return torch.where(step >= high - values, high, trial).clamp(low, high)


def flat_bounds(
    lower: Float[Tensor, "*#batch n"] | None, upper: Float[Tensor, "*#batch n"] | None, start: Float[Tensor, "*batch n"]
) -> tuple[Tensor | None, Tensor | None]:
    """Bounds of every problem's variables, a row each; both or neither.

    Raises ValueError for one without the other and, on a processor, for a lower bound above its upper one: an
    accelerator would have to be waited for.
    """
    if lower is None and upper is None:
        return None, None
    if lower is None or upper is None:
        raise ValueError("bounds: expected both or neither; use infinities")
    low, high = (bound.to(start).expand(start.shape).reshape(-1, start.shape[-1]) for bound in (lower, upper))
    if is_host(start.device) and not bool((low <= high).all()):
        raise ValueError("bounds: expected lower <= upper")
    return low, high


def _rows_with(flags: Bool[Tensor, "k n"]) -> "Int[Tensor, 'some'] | slice":
    """The rows that have a flag set; all of them on an accelerator, which would have to be asked."""
    return flags.any(-1).nonzero()[:, 0] if is_host(flags.device) else slice(None)


def _solved_with_pinned(matrix: Tensor, gradient: Tensor, pinned: Tensor, pinned_step: Tensor) -> tuple[Tensor, Tensor]:
    """The step whose pinned entries are those of `pinned_step` and whose others solve the rest."""
    if not may_hold(pinned):
        return _solved(matrix, -gradient)
    right = -gradient - (matrix @ pinned_step[..., None]).squeeze(-1)
    is_open = (~pinned).to(matrix.dtype)
    reduced = matrix * is_open[:, :, None] * is_open[:, None, :]
    reduced.diagonal(dim1=-2, dim2=-1).add_(pinned.to(matrix.dtype))
    step, is_solved = _solved(reduced, right * is_open)
    return torch.where(pinned, pinned_step, step), is_solved


def _solved(matrix: Tensor, right: Tensor) -> tuple[Tensor, Tensor]:
    factor, info = torch.linalg.cholesky_ex(matrix)
    step = torch.cholesky_solve(right[..., None], factor).squeeze(-1)
    is_solved = (info == 0) & step.isfinite().all(-1)
    return torch.where(is_solved[:, None], step, 0.0), is_solved
