"""A pass over a recording, cut into shares that processes can follow side by side."""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float

RUN_IN = 15
"""Frames that a share follows before those that it tells of: three looks at other tilts."""
_SMALLEST, _MOST = 100, 16
"""Frames of each of two shares, at least; and shares at most, for each reads the recording up to its frames."""
_WITHIN = 20  # frames from an even share, within which the one that is explained best is where a share begins


@dataclass(frozen=True, kw_only=True)
class Share:
    """Places of frames in a recording, followed by themselves."""

    followed: range
    told: range
    """Those of which it tells: after a cut, others lead to them."""


def shares_of(
    overlap: Float[np.ndarray, " t"], is_wanted: Bool[np.ndarray, " t"], *, is_backward: bool
) -> tuple[Share, ...]:
    """What can be followed side by side, in the order of the frames; together they tell of every frame that is wanted
    once. Recordings are cut alike, whoever works on them.

    overlap: of the hand by the passes before, NaN where there is none. Each share begins at a frame that this hand
    explains well, so that it needs nothing that comes before it in its own pass. is_wanted: at least one.
    """
    edges = _edges(overlap, is_wanted)
    last = len(edges) - 2
    found = []
    for place, (begin, end) in enumerate(pairwise(edges)):
        before, after = RUN_IN * (place > 0), RUN_IN * (place < last)
        if is_backward:
            found.append(Share(followed=range(begin - before, end), told=range(begin - before, end - after)))
        else:
            found.append(Share(followed=range(begin, end + after), told=range(begin + before, end + after)))
    return tuple(found)


def _edges(overlap: Float[np.ndarray, " t"], is_wanted: Bool[np.ndarray, " t"]) -> list[int]:
    """Places between shares: where no frame is wanted, else where the hand explains most, never where there is none.

    An even number, as of cores; twice as many where there are four times as many frames, so that run-ins, which take
    longer the more shares there are, stay about a tenth.
    """
    wanted = np.flatnonzero(is_wanted)
    is_long = len(wanted) >= 2 * _SMALLEST
    count = min(_MOST, 2 * math.isqrt(len(wanted) // _SMALLEST)) if is_long else 1
    fitness = np.where(is_wanted, np.nan_to_num(overlap, nan=-1.0), np.inf)
    edges = [int(wanted[0])]
    for even in (int(wanted[place * len(wanted) // count]) for place in range(1, count)):
        near = fitness[even - _WITHIN : even + _WITHIN + 1]
        if near.max() >= 0:
            edges.append(even - _WITHIN + int(near.argmax()))
    return [*edges, int(wanted[-1]) + 1]
