"""One estimate from several hands of one frame, each with a probability."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.hand import HandKinematics, HandPose

_FAR_M = 0.020
"""Mean distance of keypoints about their common middle, beyond which the mean of two hands is none that anything speaks
for. Between two places there always is one."""


@dataclass(frozen=True, kw_only=True)
class PosedHand:
    """What is told of a hand in one frame, in the world."""

    pose: Float[Tensor, "36"]
    """Pose with the root's whole rotation vector; metres and radians."""
    pose_std: Float[Tensor, "36"]
    """Those of the root's rotation are of a small turn in the world's axes."""
    keypoints: Float[Tensor, "21 3"]
    """Metres."""
    keypoints_cov: Float[Tensor, "21 3 3"]
    """Square metres."""


def combined_hand(
    hands: Sequence[PosedHand],
    weights: Float[Tensor, "hands"],
    kinematics: HandKinematics,
    shape: Float[Tensor, "shape"],
) -> PosedHand:
    """Mean and covariance of the mixture of several hands. weights: probabilities, which sum to 1.

    Only hands near the likeliest one enter the mean: halfway between two postures there is none. All enter the
    covariance, which is not smaller than theirs where they agree: followed from either side, they have the errors of
    the model's surface in common (covariance intersection, Julier and Uhlmann 1997, in place of independence).
    """
    weights = weights.to(hands[0].pose)
    first = hands[int(weights.argmax())]
    at = HandPose.of(first.pose)
    missed = torch.stack([at.step_to(HandPose.of(hand.pose)) for hand in hands])
    apart = torch.stack([(_centred(hand) - _centred(first)).norm(dim=-1).mean() for hand in hands])
    near = torch.where(apart <= _FAR_M, weights, 0.0)
    mean = (near / near.sum()) @ missed
    pose = at.retract(mean)
    keypoints = kinematics(pose.dofs, shape, root_reference=pose.reference).keypoints
    variance = torch.stack([hand.pose_std for hand in hands]).square() + (missed - mean).square()
    offset = torch.stack([hand.keypoints for hand in hands]) - keypoints
    covariance = torch.stack([hand.keypoints_cov for hand in hands]) + offset[..., :, None] * offset[..., None, :]
    return PosedHand(
        pose=pose.vector,
        pose_std=(weights @ variance).sqrt(),
        keypoints=keypoints,
        keypoints_cov=(weights[:, None, None, None] * covariance).sum(0),
    )


def _centred(hand: PosedHand) -> Float[Tensor, "21 3"]:
    return hand.keypoints - hand.keypoints.mean(0)
