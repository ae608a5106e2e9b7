"""The silhouette of an open hand with soft edges: from the colours to both sides of a mask's edge."""

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from torchhand.image import dilate, disc_kernel, erode

_BAND_PX, _BAND_SHARE = 3, 1 / 200  # half width of the band about a mask's edge: at least, and of the longer side
_LEAST_SPREAD = 1e-3  # variance of colours that is assumed of noise
_FEWEST_PIXELS = 50
_MOST_CONFUSED = 0.03  # share of pixels on the wrong side of the discriminant


def soft_silhouette(
    image: UInt8[Tensor, "height width 3"], mask: Bool[Tensor, "height width"]
) -> Float[Tensor, "height width"] | None:
    """How much of each pixel shows the hand, 0 to 1, where a mask's edge is only good to some pixels.

    Within a narrow band about the edge, Fisher's discriminant between the colours of the mask and of what surrounds it
    tells; it hardly heeds the shading, which is what colours of one side differ in. None where the colours overlap.
    """
    height, width = mask.shape
    reach = max(_BAND_PX, round(_BAND_SHARE * max(height, width)))
    inside = mask.cpu()
    core = erode(inside, disc_kernel(reach)).numpy()
    wide, ring = (dilate(inside, disc_kernel(by)).numpy() for by in (reach, 4 * reach))
    pixels = image.cpu().numpy().astype(np.float32) / 255.0
    own, other = pixels[core], pixels[ring & ~wide]
    if len(own) < _FEWEST_PIXELS or len(other) < _FEWEST_PIXELS:
        return None
    spread = np.cov(own.T) + np.cov(other.T) + _LEAST_SPREAD * np.eye(3)
    weights = np.linalg.solve(spread, np.median(own, 0) - np.median(other, 0)).astype(np.float32)
    score = pixels @ weights
    low, high = float(np.median(score[ring & ~wide])), float(np.median(score[core]))
    share = (score - low) / max(high - low, 1e-9)
    if 0.5 * float((share[core] < 0.5).mean() + (share[ring & ~wide] > 0.5).mean()) > _MOST_CONFUSED:
        return None
    soft = np.where(wide & ~core, share.clip(0.0, 1.0), inside.float().numpy()).astype(np.float32)
    return torch.from_numpy(soft).to(mask.device)
