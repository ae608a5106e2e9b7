"""Distance transforms: how far every pixel is from the nearest marked one (Ouhaddi and Horain 1998, section 7.4)."""

from typing import Literal

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.image.operations import suits_opencv

Method = Literal["exact", "kornia"]

_AT_ONCE = 1 << 24  # numbers held at a time by the pass along rows


def distance_map(
    mask: Bool[Tensor, "*batch height width"] | Float[Tensor, "*batch height width"],
    method: Method = "exact",
    *,
    kernel_size: int = 7,
) -> Float[Tensor, "*batch height width"]:
    """Euclidean distance in px of every pixel's centre from that of the nearest marked pixel; infinite if none is.

    exact  of a Bool mask: float32, right to rounding. OpenCV on a CPU, the same bits with any number of its threads;
        two exact passes in torch on other devices.
    kornia  of a Float mask, 1 where marked: differentiable in the mask. It is no Euclidean distance: it is exact along
        rows and columns, a diagonal comes out up to 29 % short, and it is good to kernel_size / 2 px only (kernel_size
        odd, 3 or more). Where nothing is marked it is 0. Usually the gradient should flow through *sampling* an exact
        map (`DistanceField`), not through making one.

    Raises ValueError for another method, for a mask of the wrong kind and for an even kernel.
    """
    if method not in ("exact", "kornia"):
        raise ValueError(f"method: expected 'exact' or 'kornia', got {method!r}")
    flat = mask.reshape(-1, *mask.shape[-2:])
    if method == "kornia":
        if not mask.dtype.is_floating_point:
            raise ValueError(f"mask: expected floating point numbers for method 'kornia', got {mask.dtype}")
        if kernel_size < 3 or kernel_size % 2 == 0:
            raise ValueError(f"kernel_size: expected an odd number of 3 or more, got {kernel_size}")
        import kornia  # a quarter of a second

        return kornia.contrib.distance_transform(flat[:, None], kernel_size).reshape(mask.shape)
    if mask.dtype != torch.bool:
        raise ValueError(f"mask: expected torch.bool for method 'exact', got {mask.dtype}")
    whole = _by_opencv(flat) if suits_opencv(flat) else distance_map_torch(flat)
    return whole.reshape(mask.shape)


def depth_map(
    mask: Bool[Tensor, "*batch height width"], *, is_border_outside: bool = False
) -> Float[Tensor, "*batch height width"]:
    """Distance in px of every pixel of a mask from the nearest one beside the mask; 0 beside it.

    The picture's border is no end of the mask, unless `is_border_outside`: then pixels all around it count as beside.
    Infinite where nothing is beside a mask.
    """
    if not is_border_outside:
        return distance_map(~mask)
    return distance_map(torch.nn.functional.pad(~mask, (1, 1, 1, 1), value=True))[..., 1:-1, 1:-1]


def _by_opencv(masks: Bool[Tensor, "n height width"]) -> Float[Tensor, "n height width"]:
    out = torch.empty(masks.shape, dtype=torch.float32)
    for mask, target in zip(masks.numpy(), out.numpy(), strict=True):
        if mask.all():
            target[:] = 0.0
        elif mask.any():
            free = np.logical_not(mask).view(np.uint8)
            cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE, dst=target)
            # Its last bit is another with another number of OpenCV's threads; squares are whole numbers.
            np.sqrt(np.rint(np.square(target, out=target), out=target), out=target)
        else:
            target[:] = np.inf
    return out


def distance_map_torch(mask: Bool[Tensor, "*batch height width"]) -> Float[Tensor, "*batch height width"]:
    """The exact map in torch alone, on any device: distances along columns, then the least of (x - x')² + those².

    Memory is bounded by working through a few rows at a time.
    """
    height, width = mask.shape[-2:]
    flat = mask.reshape(-1, height, width)
    row = torch.arange(height, device=mask.device)[:, None].expand(height, width)
    far = 4 * (height + width)  # farther than any pixel
    above = torch.where(flat, row, -far).cummax(1).values
    below = torch.where(flat, -row, -far).flip(1).cummax(1).values.flip(1).neg()
    along = torch.minimum(row - above, below - row).to(torch.float32)
    along = torch.where(along < far / 2, along, torch.inf).square().reshape(-1, width)
    column = torch.arange(width, device=mask.device, dtype=torch.float32)
    offsets = (column[:, None] - column).square()
    together = max(1, _AT_ONCE // (width * width))
    rows = [(rows[:, None] + offsets).amin(-1) for rows in along.split(together)]
    squared = torch.cat(rows) if rows else along
    return squared.sqrt().reshape(mask.shape)
