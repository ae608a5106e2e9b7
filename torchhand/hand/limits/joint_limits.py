"""Joint limits on whole poses."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.hand.kinematics import Skeleton


def clamp_to_limits(pose: Float[Tensor, "*batch 36"], skeleton: Skeleton) -> Float[Tensor, "*batch 36"]:
    """The nearest pose within the joint limits; the root is left as it is."""
    return torch.cat((pose[..., :6], skeleton.within_limits(pose[..., 6:])), -1)
