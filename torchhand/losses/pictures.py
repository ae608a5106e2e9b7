"""Losses between soft silhouettes (`torchhand.view.SoftRenderer`) and masks of real hands."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.errors import require
from torchhand.image import distance_map
from torchhand.losses.reduction import Reduction, reduced
from torchhand.precision import own_precision


@own_precision
def silhouette_loss(
    coverage: Float[Tensor, "*batch height width"],
    mask: Bool[Tensor, "*#batch height width"] | Float[Tensor, "*#batch height width"],
    known: Bool[Tensor, "*#batch height width"] | None = None,
    *,
    reduction: Reduction = "mean",
) -> Float[Tensor, "*out"]:
    """One less the overlap (intersection over union of areas) of a soft silhouette and a mask: 0 equal, 1 apart.

    coverage: share of each pixel that shows the hand, 0 to 1. mask: where it should be; True, or a share of the pixel.
    known: pixels that count, for masks that say nothing about some of them; all of them if None.

    It pulls only where silhouette and mask meet: a hand that lies beside its mask gets no direction from it. Add
    `distance_map_loss` until they overlap. Raises ValueError for masks of whole numbers, whose 255 is no share.
    """
    is_share = mask.dtype == torch.bool or mask.is_floating_point()
    require(is_share, "mask", "bool, or shares as floating-point numbers", mask.dtype)
    require(known is None or known.dtype == torch.bool, "known", "bool", None if known is None else known.dtype)
    wanted = mask.to(coverage)
    both, either = coverage * wanted, coverage + wanted - coverage * wanted
    if known is not None:
        both, either = both * known, either * known
    overlap = both.sum((-2, -1)) / either.sum((-2, -1)).clamp_min(torch.finfo(coverage.dtype).tiny)
    return reduced(1 - overlap, reduction)


@own_precision
def distance_map_loss(
    coverage: Float[Tensor, "*batch height width"],
    distance: Float[Tensor, "*#batch height width"],
    *,
    reduction: Reduction = "mean",
) -> Float[Tensor, "*out"]:
    """How far what is wrongly covered, or wrongly not, lies from the mask's outline: px, summed over pixels and divided
    by the mask's area.

    Σ (C − M) d / Σ M, with the coverage C, the mask M = (d < 0) and its signed distance d: never negative, and 0 where
    the silhouette is the mask. Its derivative at the silhouette's edge is d there, so that it pulls from any distance,
    on both sides; the boundary loss of Kervadec et al. (2019). distance: as `signed_distance` gives it, px; where it is
    not finite (an empty mask) nothing counts.
    """
    is_there = distance.isfinite()
    distance = torch.where(is_there, distance, 0.0)
    mask = (distance < 0).to(coverage)
    amount = ((coverage - mask) * distance).sum((-2, -1)) / mask.sum((-2, -1)).clamp_min(1)
    return reduced(amount, reduction)


def signed_distance(
    mask: Bool[Tensor, "*batch height width"], *, dtype: torch.dtype = torch.float32
) -> Float[Tensor, "*batch height width"]:
    """Distance of every pixel's centre from the outline of a mask, px: negative inside, exact, no gradients.

    Infinite where a mask is empty, or fills the picture. Make it once per mask.
    """
    beyond, within = distance_map(mask), distance_map(~mask)
    return torch.where(mask, 0.5 - within, beyond - 0.5).to(dtype)
