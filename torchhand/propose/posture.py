"""What the network tells of the posture of a hand whose place and direction are known roughly: one view, no search."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.devices import kept
from torchhand.geometry import cosine_between, rotation_from_vector, vector_from_rotation
from torchhand.hand import JOINT_DOFS, HandKinematics, HandPose
from torchhand.propose.hypotheses import Silhouette, mirrored_hands, sampled_channels, views_of_hands
from torchhand.propose.network import ProposalNetwork
from torchhand.propose.views import SquareViews

# Root mean square errors in degrees of the mean angles, by the ending of the DOF's name: medians over the sequences of
# another maker's hand that `torchhand learn_proposals --evaluate` was given (`models/proposals/README.md`).
_STD_DEG = {
    "thumb_cmc_fe": 9.0,
    "thumb_cmc_aa": 5.0,
    "thumb_mcp_fe": 21.0,
    "thumb_mcp_aa": 9.0,
    "thumb_ip_fe": 13.0,
    "_cmc_fe": 2.0,
    "_mcp_fe": 11.0,
    "_mcp_aa": 10.0,
    "_pip_fe": 12.0,
    "_dip_fe": 7.0,
}
_OTHER_STD_DEG = 10.0
_DIRECTION_STD = math.radians(30.0)
"""Of the direction of the best of the eight hypotheses, as measured there on one view of held-out simulated hands and
on pictures (11° to 27°), with a margin."""

_UNTOLD = 0.1  # share of pictures in which no hypothesis is about the hand


@dataclass(frozen=True, kw_only=True)
class LearnedPosture:
    """Joint angles as the network sees them in one picture."""

    joints: Float[Tensor, "30"]
    """Mean of the hypotheses, radians, in the order of JOINT_DOFS."""
    variance: Float[Tensor, "30"]
    """Of the hypotheses about it, and of the network's errors, radians²."""
    rotation: Float[Tensor, "k 3 3"]
    """world_from_hand of every hypothesis."""
    weight: Float[Tensor, "k"]
    """Probabilities of the hypotheses; they sum to 1."""
    spread: Float[Tensor, ""]
    """Error that the network expects of the hypotheses (`ViewedHands.spread`), their mean by probability."""

    def direction_agreement(self, rotation: Float[Tensor, "3 3"]) -> Float[Tensor, ""]:
        """How far the hypotheses bear out a direction of the hand (world_from_hand): their mean, by probability, of
        exp(-θ² / 2σ²), θ the angle between theirs and it and σ the network's own error; 0 to 1."""
        return self._shares(rotation).sum()

    def direction_near(self, rotation: Float[Tensor, "3 3"]) -> tuple[Float[Tensor, "3 3"], Float[Tensor, ""]]:
        """Direction (world_from_hand) of the hypotheses about a hand of some direction, and its inverse variance,
        radians⁻²: those of one component of the mixture as expectation maximization sees it, next to which all far
        hypotheses count as if they told nothing."""
        share = self._shares(rotation)
        turns = vector_from_rotation(self.rotation @ rotation.to(self.rotation).mT)
        mean = (share[:, None] * turns).sum(0) / share.sum().clamp_min(_UNTOLD)
        trust = share.sum() / (share.sum() + _UNTOLD)
        return rotation_from_vector(mean) @ rotation.to(self.rotation), trust / _DIRECTION_STD**2

    def _shares(self, rotation: Float[Tensor, "3 3"]) -> Float[Tensor, "k"]:
        angle = cosine_between(self.rotation, rotation.to(self.rotation)).clamp(-1, 1).arccos()
        return self.weight * (-0.5 * (angle / _DIRECTION_STD).square()).exp()


def learned_posture(
    network: ProposalNetwork,
    silhouette: Silhouette,
    kinematics: HandKinematics,
    pose: HandPose,
    shape: Float[Tensor, "shape"],
) -> LearnedPosture:
    """The posture and the direction of the hand that stands about where `pose` () in the world has it, seen upright and
    filling the view.

    Raises ValueError for a camera that is no pinhole camera.
    """
    channels, views = channels_about(silhouette, kinematics, pose, shape)
    found = network(channels)
    found = mirrored_hands(found) if kinematics.side == "left" else found
    share = found.log_weight[0].to(pose.dofs).softmax(-1)
    weight = share[:, None]
    joints = found.joints[0].to(pose.dofs)
    mean = (weight * joints).sum(0)
    spread = (weight * (joints - mean).square()).sum(0)
    world_from_view = silhouette.camera.rotation.to(pose.dofs).mT @ views.cam_from_view[0].to(pose.dofs)
    return LearnedPosture(
        joints=mean,
        variance=spread + _error_variance().to(spread),
        rotation=world_from_view @ found.rotation[0].to(pose.dofs),
        weight=share,
        spread=(share * found.spread[0].to(share)).sum(),
    )


def channels_about(
    silhouette: Silhouette, kinematics: HandKinematics, pose: HandPose, shape: Float[Tensor, "shape"]
) -> tuple[Float[Tensor, "1 channels side side"], SquareViews]:
    """What a network sees about a hand at `pose` () in the world, upright and filling the view, a left one in the
    mirror; and that view.

    Raises ValueError for a camera that is no pinhole camera.
    """
    if silhouette.camera.kind != "pinhole":
        raise ValueError(f"camera: expected a pinhole camera, got {silhouette.camera.kind}")
    frames = kinematics(pose.dofs[None], shape, root_reference=pose.reference[None])
    to_cam, place = silhouette.camera.rotation.to(pose.dofs), silhouette.camera.translation.to(pose.dofs)
    points = frames.keypoints @ to_cam.mT + place
    fingers = (to_cam @ pose.rotation)[:, 1][None]
    length = shape[kinematics.shape_space.names.index("hand_length")]
    views = views_of_hands(points, fingers, length)
    channels = sampled_channels(silhouette, views)
    return (channels.flip(-1) if kinematics.side == "left" else channels), views


@kept(1)
def _error_variance() -> Float[Tensor, "30"]:
    std = []
    for name in JOINT_DOFS:
        ending = name if name in _STD_DEG else name[name.index("_") :]
        std.append(_STD_DEG.get(ending, _OTHER_STD_DEG))
    return torch.deg2rad(torch.tensor(std, dtype=torch.float64)).square()
