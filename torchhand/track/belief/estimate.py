"""From a belief to what is told of a frame: pose, keypoints and their covariances."""

from dataclasses import dataclass
from functools import lru_cache

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.geometry import Camera
from torchhand.hand import HandKinematics, HandPose, PoseJacobian, PoseSpace, ShapeSpace
from torchhand.hand.limits import clamp_to_limits
from torchhand.track.belief.motion import HandMotion
from torchhand.track.belief.state import FollowedHand

_JOINT_CENTRE_STD = 0.004
"""Metres: two hand models place their joint centres a few millimetres apart under the same skin."""


@dataclass(frozen=True, kw_only=True)
class PosedBelief:
    """What a belief says of a hand, in the world."""

    pose: Float[Tensor, "36"]
    """Pose with the root's whole rotation vector; metres and radians."""
    pose_std: Float[Tensor, "36"]
    """0 for DOFs that are held; those of the root's rotation are of a small turn in the world's axes."""
    root_rotation: Float[Tensor, "3 3"]
    """Rotation world_from_hand."""
    keypoints: Float[Tensor, "21 3"]
    """Keypoints, metres."""
    keypoints_cov: Float[Tensor, "21 3 3"]
    """Square metres: of the belief, and of joint centres within the flesh, which no filter knows."""


def posed_belief(
    hand: FollowedHand, motion: HandMotion, kinematics: HandKinematics, shape: Float[Tensor, "shape"]
) -> PosedBelief:
    """Pose and keypoints of a followed hand with their covariances, first order."""
    space, prior = motion.space.about(hand.base), motion.prior(hand)
    return _posed(space.dof(prior.mean), hand.reference, prior.covariance, space, kinematics, shape)


def posed_gaussian(
    pose: HandPose,
    covariance: Float[Tensor, "free free"],
    space: PoseSpace,
    kinematics: HandKinematics,
    shape: Float[Tensor, "shape"],
) -> PosedBelief:
    """The same of a pose () with a covariance of a space's free parameters, the rotation a left perturbation of it."""
    at = pose.normalized()
    return _posed(at.dofs, at.reference, covariance, space, kinematics, shape)


def _posed(
    wanted: Float[Tensor, "36"],
    reference: Float[Tensor, "3 3"],
    covariance: Float[Tensor, "free free"],
    space: PoseSpace,
    kinematics: HandKinematics,
    shape: Float[Tensor, "shape"],
) -> PosedBelief:
    dofs = clamp_to_limits(wanted, kinematics.skeleton)
    basis = (dofs == wanted)[:, None] * space.basis  # a tied angle may have stopped at its limit
    frames = kinematics(dofs, shape, root_reference=reference)
    jacobian = _jacobian_of(kinematics)(dofs, frames) @ basis
    pose = HandPose(dofs=dofs, reference=reference)
    eye = torch.eye(3, dtype=dofs.dtype)
    return PosedBelief(
        pose=pose.vector,
        pose_std=(basis @ covariance @ basis.T).diagonal().clamp_min(0).sqrt(),
        root_rotation=pose.rotation,
        keypoints=frames.keypoints,
        keypoints_cov=jacobian @ covariance @ jacobian.mT + _JOINT_CENTRE_STD**2 * eye,
    )


@lru_cache(maxsize=8)
def _jacobian_of(kinematics: HandKinematics) -> PoseJacobian:
    """Jacobian in all DOFs; laid out once for each kinematics module."""
    with torch.inference_mode(False):  # kept for callers in any mode
        return PoseJacobian(kinematics)


def unknown_scale_std(space: ShapeSpace, camera: Camera, *, is_shape_known: bool) -> float:
    """Spread over people of the hand's length, as a share, where it decides the distance and was not measured."""
    if is_shape_known or camera.kind == "orthographic":
        return 0.0
    index = space.names.index("hand_length")
    return float(space.std[index] / space.default[index])


def scale_covariance(keypoints: Float[Tensor, "21 3"], scale_std: float) -> Float[Tensor, "21 3 3"]:
    """What an unknown hand length adds before one camera, which is the world: size and distance in common."""
    return scale_std**2 * (keypoints[:, :, None] * keypoints[:, None, :])
