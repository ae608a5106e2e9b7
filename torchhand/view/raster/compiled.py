"""The inner loop of the z-buffer as machine code, where numba is installed (extra `fast`): the same faces in the same
pixels as the tensor operations give, several times faster."""

import importlib
import inspect
import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.devices import is_host


def can_compile(like: Tensor) -> bool:
    """Whether tensors of this kind are drawn by machine code."""
    return is_host(like.device) and like.dtype in (torch.float32, torch.float64) and _compiled() is not None


def nearest_compiled(
    points_px: Float[Tensor, "meshes vertices 2"],
    nearness: Float[Tensor, "meshes vertices"],
    faces: Int[Tensor, "faces 3"],
    is_drawn: Bool[Tensor, "meshes"],
    size: tuple[int, int],
    away: float,
) -> tuple[Float[Tensor, "meshes height width"], Int[Tensor, "meshes height width"]]:
    """Nearness and face (-inf and -1 where there is none) of what every pixel sees; of equally near ones the first.

    is_drawn: meshes of which every vertex is in front of the camera; nothing of others is drawn. size: height, width.
    away: sign of the area of faces that are left out; 0 keeps all.
    """
    fill = _compiled()
    assert fill is not None
    nearest = nearness.new_full((len(nearness), *size), -torch.inf)
    winner = torch.full_like(nearest, -1, dtype=torch.long)
    arrays = (tensor.contiguous().numpy() for tensor in (points_px, nearness, faces, is_drawn))
    fill(*arrays, away, nearest.numpy(), winner.numpy())
    return nearest, winner


@lru_cache(maxsize=1)
def _compiled() -> Callable[..., None] | None:
    """`_fill` by numba, whose machine code is kept on disk for later processes where that can be written."""
    try:
        numba: Any = importlib.import_module("numba")
    except ImportError:
        return None
    fill = inspect.unwrap(_fill)  # without checks of its arguments
    try:
        return numba.njit(cache=True, nogil=True, error_model="numpy")(fill)
    except RuntimeError:  # no folder to keep it in
        return numba.njit(nogil=True, error_model="numpy")(fill)


def _fill(
    points: np.ndarray,
    nearness: np.ndarray,
    faces: np.ndarray,
    is_drawn: np.ndarray,
    away: float,
    nearest: np.ndarray,
    winner: np.ndarray,
) -> None:
    """Draw every face row by row, with the arithmetic of `spans.row_spans` and `raster._filled`: what neighbours
    compute of their common edge is equal to the last bit. Numba compiles it; it calls nothing of Python's."""
    half, one, zero = np.float32(0.5), np.float32(1), np.float32(0)
    height, width = nearest.shape[1:]
    for mesh in np.flatnonzero(is_drawn):
        for face in range(len(faces)):
            a, b, c = faces[face]
            x0, y0 = points[mesh, a]
            x1, y1 = points[mesh, b]
            x2, y2 = points[mesh, c]
            ux, uy, vx, vy = x1 - x0, y1 - y0, x2 - x0, y2 - y0
            area = ux * vy - uy * vx
            if away != 0 and not area * away < 0:
                continue
            left, right = min(x0, min(x1, x2)), max(x0, max(x1, x2))
            if right < 0 or left > width - 1 or math.ceil(left) > math.floor(right):
                continue
            start_x, start_y, base = x0, y0, nearness[mesh, a]
            rise_u, rise_v = nearness[mesh, b] - base, nearness[mesh, c] - base
            low = min(base, min(nearness[mesh, b], nearness[mesh, c]))
            high = max(base, max(nearness[mesh, b], nearness[mesh, c]))
            if y1 < y0 or (y1 == y0 and x1 < x0):
                x0, y0, x1, y1 = x1, y1, x0, y0
            if y2 < y1 or (y2 == y1 and x2 < x1):
                x1, y1, x2, y2 = x2, y2, x1, y1
            if y1 < y0 or (y1 == y0 and x1 < x0):
                x0, y0, x1, y1 = x1, y1, x0, y0
            if not y0 < y2:
                continue
            along_x = (rise_u * vy - rise_v * uy) / area
            along_y = (rise_v * ux - rise_u * vx) / area
            along_x = along_x if math.isfinite(along_x) else zero
            along_y = along_y if math.isfinite(along_y) else zero
            for row in range(max(math.ceil(y0), 0), min(math.floor(y2), height - 1) + 1):
                y = np.float32(row)
                t = (y - y0) / (y2 - y0)
                long = x0 + t * (x2 - x0) if t < half else x2 - (x2 - x0) * (one - t)
                # In the row of the middle corner both short edges meet; the upper one counts unless it is level.
                if y <= y1 and y0 < y1:
                    t = (y - y0) / (y1 - y0)
                    short = x0 + t * (x1 - x0) if t < half else x1 - (x1 - x0) * (one - t)
                else:
                    t = (y - y1) / (y2 - y1)
                    short = x1 + t * (x2 - x1) if t < half else x2 - (x2 - x1) * (one - t)
                first = max(math.ceil(min(long, short)), 0)
                last = min(math.floor(max(long, short)), width - 1)
                if first > last:
                    continue
                begin = base + along_x * (np.float32(first) - start_x) + along_y * (y - start_y)
                end = base + along_x * (np.float32(last) - start_x) + along_y * (y - start_y)
                begin, end = min(max(begin, low), high), min(max(end, low), high)
                slope = (end - begin) / np.float32(max(last - first, 1))
                for step in range(last - first + 1):
                    near = begin + slope * np.float32(step)
                    if near > nearest[mesh, row, first + step]:
                        nearest[mesh, row, first + step] = near
                        winner[mesh, row, first + step] = face
