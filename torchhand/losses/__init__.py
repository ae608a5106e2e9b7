"""Losses for training loops and fits by gradient descent: a batch of hands in, one number per hand out, or one in all.

Every function has `reduction`, as torch's own losses: "none" gives one loss per element of the batch, "mean" and "sum"
reduce these.
"""

from torchhand.losses.hands import penetration_loss, prior_loss
from torchhand.losses.pictures import distance_map_loss, signed_distance, silhouette_loss
from torchhand.losses.points import keypoint_loss
from torchhand.losses.reduction import Reduction

__all__ = [
    "Reduction",
    "distance_map_loss",
    "keypoint_loss",
    "penetration_loss",
    "prior_loss",
    "signed_distance",
    "silhouette_loss",
]
