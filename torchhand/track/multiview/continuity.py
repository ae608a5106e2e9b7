"""One hand in many frames: of several ways to explain each, those that agree about how the hand faces.

Two silhouettes hardly tell a palm from a back, and each frame decides by chance. But a hand rarely turns over between
two frames, so those that are sure decide for those that are not (the most probable path; Viterbi 1967).
"""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

_HALF_TURN_SCORE = 0.06  # score that half a turn between two frames is worth


def viterbi_path(scores: Sequence[Float[Tensor, "_ways"]], facing: Sequence[Float[Tensor, "_ways 3 3"]]) -> list[int]:
    """Which way to explain each frame: the largest sum of scores, less what the turns from each to the next cost.

    scores: 0 to 1, of at least one way for each frame, in order of time. facing: world_from_hand of each.
    """
    if not scores:
        return []
    total, came_from = scores[0], []
    for before, here, score in zip(facing, facing[1:], scores[1:], strict=False):
        cosine = (torch.einsum("aij,bij->ab", before, here) - 1) / 2
        reached = total[:, None] - _HALF_TURN_SCORE * (1 - cosine) / 2
        best, origin = reached.max(0)
        came_from.append(origin)
        total = best + score
    path = [int(total.argmax())]
    for origin in reversed(came_from):
        path.append(int(origin[path[-1]]))
    return path[::-1]
