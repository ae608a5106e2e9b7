"""Where the joints of a nearly fitted hand's digits are, by trying: shading tells at once, but only close by.

A joint that is a few pixels away along its digit has found another crease, or none, and no step of Newton's leads out.
Moved along the digit, all else held, its own squares fit better. All digits are moved at the same time.
"""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.fit.open_hand.problem import OpenHandProblem
from torchhand.fit.open_hand.shading import Shading, ShadingRows
from torchhand.hand import FINGERS, PRIMITIVE_NAMES

_MOVES = (-6, -4, -2, -1, 1, 2, 4, 6)
_LEVELS = (1, 0)  # the last joint of every digit, and the one before
_STEP = 0.005  # of one move, share of the hand's length
_LEAST_GAIN = 8.0  # of the cost, half squared standard deviations, for which a joint is moved
_GROSS = 6.0  # grey levels
_BONES = {
    finger: ("metacarpal", "proximal", "distal") if finger == "thumb" else ("proximal", "middle", "distal")
    for finger in FINGERS
}


def moved_joints(
    shading: Shading, problem: OpenHandProblem, values: Float[Tensor, "n"], rows: ShadingRows, noise: float
) -> Float[Tensor, "n"]:
    """The values with those joints moved whose digits' shading fits clearly better so; `rows` are theirs."""
    digit = _DIGIT[shading.parts(values)]
    shading = shading.restricted(digit < len(FINGERS), rows)
    ways = [[_along(problem, finger, level) for finger in FINGERS] for level in _LEVELS]
    tried = [problem.clamped(values + move * _STEP * torch.stack(way).sum(0)) for way in ways for move in _MOVES]
    here, *there = (_costs(rows, digit, noise) for rows in shading.without_slopes(torch.stack((values, *tried))))
    result = values
    for way, costs in zip(ways, torch.stack(there).chunk(len(_LEVELS)), strict=True):
        least, best = costs.min(0)
        for finger, along in enumerate(way):
            if least[finger] < here[finger] - _LEAST_GAIN:
                result = result + _MOVES[int(best[finger])] * _STEP * along
    return problem.clamped(result)


def _along(problem: OpenHandProblem, finger: str, level: int) -> Float[Tensor, "n"]:
    """One bone longer by the hand's length, and the next shorter."""
    names = [problem.people.space.names[i] for i in problem.free_shape.tolist()]
    way, first = torch.zeros_like(problem.std), len(problem.free_pose)
    one, other = (first + names.index(f"{finger}_{bone}") for bone in _BONES[finger][level : level + 2])
    way[one], way[other] = 1 / problem.std[one], -1 / problem.std[other]
    return way


def _costs(rows: ShadingRows, digit: Int[Tensor, "squares"], noise: float) -> Float[Tensor, "5"]:
    """Of every digit's squares; those that cannot be explained cost as much as others on average."""
    error = rows.residual.square()
    cost = 0.5 * error / (1 + error / _GROSS**2) / (noise**2 / rows.count + rows.variance)
    own = digit[rows.square]
    count = len(FINGERS) + 1
    total = cost.new_zeros(count).index_add_(0, own, cost)
    share = own.bincount(minlength=count).clamp_min(1) / digit.bincount(minlength=count).clamp_min(1)
    return (total / share)[: len(FINGERS)]


_DIGIT = torch.tensor(
    [next((i for i, finger in enumerate(FINGERS) if name.startswith(finger)), len(FINGERS)) for name in PRIMITIVE_NAMES]
    + [len(FINGERS)]
)
"""Of every part: 0 to 4 thumb to little, 5 the palm; the last stands for no part."""
