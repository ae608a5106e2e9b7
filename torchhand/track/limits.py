"""Joint limits on whole poses."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.hand import Skeleton


def clamp_to_limits(pose: Float[Tensor, "*batch 36"], skeleton: Skeleton) -> Float[Tensor, "*batch 36"]:
    """The nearest pose within the joint limits; the root is left as it is."""
    lower, upper = skeleton.lower.to(pose), skeleton.upper.to(pose)
    return torch.cat((pose[..., :6], torch.maximum(torch.minimum(pose[..., 6:], upper), lower)), -1)
