"""From a belief to what is told of a frame: pose, keypoints and their covariances."""

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from torchhand.devices import kept
from torchhand.geometry import Camera
from torchhand.hand import (
    DOFS,
    JOINT_DOFS,
    TIPS,
    HandFrames,
    HandKinematics,
    HandPose,
    PoseJacobian,
    PoseSpace,
    ShapeSpace,
    centre_covariance,
)
from torchhand.hand.limits import clamp_to_limits
from torchhand.track.belief.motion import HandMotion
from torchhand.track.belief.state import FollowedHand

_ROOT = len(DOFS) - len(JOINT_DOFS)


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
    tip_std: Float[Tensor, "5"]
    """Standard deviation of every fingertip, thumb to little, about the wrist as the joints leave it open, metres: root
    of the sum over the three axes."""


def posed_belief(
    hand: FollowedHand,
    motion: HandMotion,
    kinematics: HandKinematics,
    shape: Float[Tensor, "shape"],
    *,
    overconfidence: float = 1.0,
    frames: HandFrames | None = None,
) -> PosedBelief:
    """Pose and keypoints of a followed hand with their covariances, first order.

    overconfidence: factor by which the belief's covariance is too small (`UpdateRule.overconfidence`).
    frames: of `HandMotion.pose`, where they are known.
    """
    space, prior = motion.space.about(hand.base), motion.prior(hand)
    at = HandPose(dofs=space.dof(prior.mean), reference=hand.reference)
    return posed_gaussian(at, overconfidence * prior.covariance, space, kinematics, shape, frames)


def posed_gaussian(
    pose: HandPose,
    covariance: Float[Tensor, "free free"],
    space: PoseSpace,
    kinematics: HandKinematics,
    shape: Float[Tensor, "shape"],
    frames: HandFrames | None = None,
) -> PosedBelief:
    """Pose () within the limits and its keypoints, from a covariance of a space's free parameters; the rotation about
    the pose's reference. frames: of the pose within the limits, where they are known."""
    dofs = clamp_to_limits(pose.dofs, kinematics.skeleton)
    basis = (dofs == pose.dofs)[:, None] * space.basis  # a tied angle may have stopped at its limit
    bones: HandFrames = kinematics(dofs, shape, root_reference=pose.reference) if frames is None else frames
    moved = _jacobian_of(kinematics)(dofs, bones)
    jacobian, bent = moved @ basis, moved[list(TIPS), :, _ROOT:] @ basis[_ROOT:]
    limited = HandPose(dofs=dofs, reference=pose.reference)
    return PosedBelief(
        pose=limited.vector,
        pose_std=(basis @ covariance @ basis.T).diagonal().clamp_min(0).sqrt(),
        root_rotation=limited.rotation,
        keypoints=bones.keypoints,
        keypoints_cov=jacobian @ covariance @ jacobian.mT + centre_covariance(bones.keypoints),
        tip_std=((bent @ covariance) * bent).sum((-2, -1)).clamp_min(0).sqrt(),
    )


@kept(8)
def _jacobian_of(kinematics: HandKinematics) -> PoseJacobian:
    """Jacobian in all DOFs; laid out once for each kinematics module."""
    return PoseJacobian(kinematics)


def unknown_scale_std(space: ShapeSpace, camera: Camera, *, is_shape_known: bool) -> float:
    """Spread over people of the hand's length, as a share, where it decides the distance and was not measured."""
    if is_shape_known or camera.kind == "orthographic":
        return 0.0
    index = space.names.index("hand_length")
    return float(space.std[index] / space.default[index])
