"""Area, centre and axes of a mask."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor


@dataclass(frozen=True, kw_only=True)
class MaskMoments:
    """Moments of a mask up to the second; NaN but for the area where the mask is empty."""

    area: Float[Tensor, "*batch"]
    """Sum of the mask, px²."""
    centroid_px: Float[Tensor, "*batch 2"]
    """Centroid (x, y), px."""
    covariance_px2: Float[Tensor, "*batch 2 2"]
    """Second central moments over the area, px²."""

    @property
    def axis_angle(self) -> Float[Tensor, "*batch"]:
        """Direction of the long axis from +x towards +y (down), radians in [-pi/2, pi/2]; a round mask has none."""
        xx, xy, yy = self._entries()
        return 0.5 * torch.atan2(2.0 * xy, xx - yy)

    @property
    def axis(self) -> Float[Tensor, "*batch 2"]:
        """Unit vector along the long axis with x >= 0; which end is the head the moments do not know."""
        angle = self.axis_angle
        return torch.stack([torch.cos(angle), torch.sin(angle)], dim=-1)

    def _entries(self) -> tuple[Tensor, Tensor, Tensor]:
        return self.covariance_px2[..., 0, 0], self.covariance_px2[..., 0, 1], self.covariance_px2[..., 1, 1]


def mask_moments(mask: Bool[Tensor, "*batch height width"] | Float[Tensor, "*batch height width"]) -> MaskMoments:
    """Moments of masks or of soft masks (weights >= 0), differentiable in the latter.

    Pixels are points at their centres. A Bool mask is summed in float32.
    """
    weights = mask if mask.is_floating_point() else mask.to(torch.float32)
    height, width = weights.shape[-2:]
    x = torch.arange(width, device=weights.device, dtype=weights.dtype) - 0.5 * (width - 1)
    y = torch.arange(height, device=weights.device, dtype=weights.dtype) - 0.5 * (height - 1)
    columns, rows = weights.sum(dim=-2), weights.sum(dim=-1)
    area = columns.sum(dim=-1)
    centre_x = (columns @ x) / area
    centre_y = (rows @ y) / area
    dx, dy = x - centre_x[..., None], y - centre_y[..., None]
    xx = (columns * dx**2).sum(dim=-1) / area
    yy = (rows * dy**2).sum(dim=-1) / area
    xy = ((weights @ dx[..., None])[..., 0] * dy).sum(dim=-1) / area
    covariance = torch.stack([torch.stack([xx, xy], dim=-1), torch.stack([xy, yy], dim=-1)], dim=-2)
    centroid = torch.stack([centre_x + 0.5 * (width - 1), centre_y + 0.5 * (height - 1)], dim=-1)
    return MaskMoments(area=area, centroid_px=centroid, covariance_px2=covariance)
