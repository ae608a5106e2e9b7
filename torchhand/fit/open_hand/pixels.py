"""The brightness of a hand in a picture, on a grid of squares of pixels within its silhouette."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Shaped, UInt8
from torch import Tensor

from torchhand.geometry import Camera
from torchhand.image import erode, square_kernel

_MARGIN_PX = 2  # from the silhouette's edge, where pixels mix
_LUMA = np.array((0.299, 0.587, 0.114), np.float32)  # of red, green and blue, as in JPEG, whose luminance is sharpest
_CELL = 3  # squares to a side of those that become one
_FEWEST = 200  # squares that show enough of a hand


@dataclass(frozen=True, kw_only=True)
class PixelGrid:
    """Squares of pixels; the grid is as tall and wide as the silhouette."""

    camera: Camera
    """Whose pixels the squares are, in its own frame."""
    value: Float[Tensor, "squares"]
    """Mean luminance, grey levels of 255, row by row."""
    is_inside: Bool[Tensor, "squares"]
    """Whether all of the square shows the hand."""
    origin: Float[Tensor, "squares 3"]
    direction: Float[Tensor, "squares 3"]
    """Of the ray through the middle of a square; z = 1."""
    count: Float[Tensor, "squares"]
    """Squares that a value is the mean of: its noise is that much smaller in variance."""

    @property
    def size(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.camera.height, self.camera.width

    def image(self, values: Shaped[Tensor, "squares"]) -> Shaped[Tensor, "rows columns"]:
        return values.reshape(self.size)


def pixel_grid(
    image: UInt8[Tensor, "height width 3"], mask: Bool[Tensor, "height width"], camera: Camera, step: int
) -> PixelGrid | None:
    """The grid of squares of step x step pixels; None where hardly any of them lies within the mask."""
    rows, columns = (length // step for length in mask.shape)
    if rows == 0 or columns == 0:
        return None
    shrunk = erode(mask.cpu(), square_kernel(_MARGIN_PX)).numpy()
    luma = image.cpu().numpy().astype(np.float32) @ _LUMA
    inside, value = (_means(plane.astype(np.float32), rows, columns, step) for plane in (shrunk, luma))
    y, x = np.nonzero(inside >= 1.0)
    if len(y) < _FEWEST:
        return None
    top, left, bottom, right = int(y.min()), int(x.min()), int(y.max()) + 1, int(x.max()) + 1
    smaller = camera.resized(1.0 / step)
    intrinsics = smaller.intrinsics.clone()
    intrinsics[:2, 2] -= torch.tensor((left, top), dtype=intrinsics.dtype)
    eye = torch.eye(3, dtype=intrinsics.dtype)
    own = replace(
        smaller,
        intrinsics=intrinsics,
        width=right - left,
        height=bottom - top,
        rotation=eye,
        translation=torch.zeros_like(eye[0]),
    )
    grid = torch.meshgrid(torch.arange(own.height), torch.arange(own.width), indexing="ij")
    origin, direction = own.rays(torch.stack((grid[1], grid[0]), -1).reshape(-1, 2).to(intrinsics))
    window = (slice(top, bottom), slice(left, right))
    return PixelGrid(
        camera=own,
        value=torch.from_numpy(value[window].astype(np.float64)).flatten(),
        is_inside=torch.from_numpy(inside[window] >= 1.0).flatten(),
        origin=origin,
        direction=direction,
        count=torch.ones(len(origin), dtype=intrinsics.dtype),
    )


def thinned(grid: PixelGrid, near: Bool[Tensor, "squares"]) -> PixelGrid:
    """The same squares where `near`; elsewhere every third to both directions, with the mean of its nine."""
    rows, columns = (length // _CELL * _CELL for length in grid.size)

    def cells(plane: Tensor) -> Tensor:
        whole = plane.reshape(grid.size)[:rows, :columns]
        return whole.reshape(rows // _CELL, _CELL, columns // _CELL, _CELL).transpose(1, 2).flatten(2)

    is_whole = cells(grid.is_inside & ~near).all(-1)
    middle = torch.zeros(_CELL, _CELL, dtype=torch.bool)
    middle[_CELL // 2, _CELL // 2] = True
    is_middle = torch.zeros(grid.size, dtype=torch.bool)
    is_middle[:rows, :columns] = torch.kron(is_whole.byte(), middle.byte()).bool()
    means = torch.zeros(grid.size, dtype=grid.value.dtype)
    means[:rows, :columns] = torch.kron(cells(grid.value).mean(-1), middle.to(grid.value))
    is_middle = is_middle.flatten()
    return replace(
        grid,
        value=torch.where(is_middle, means.flatten(), grid.value),
        is_inside=grid.is_inside & (near | is_middle),
        count=torch.where(is_middle, grid.count * _CELL**2, grid.count),
    )


def _means(plane: np.ndarray, rows: int, columns: int, step: int) -> np.ndarray:
    """Means over the squares; what is left over at the right and below is cut off."""
    return plane[: rows * step, : columns * step].reshape(rows, step, columns, step).mean((1, 3))
