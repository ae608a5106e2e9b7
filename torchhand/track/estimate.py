"""From the tracker's belief to what is told of a frame: pose, keypoints and their covariances."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.files import FrameStatus
from torchhand.geometry import Camera, rotation_from_vector, vector_from_rotation
from torchhand.hand import HandKinematics, PoseJacobian, PoseSpace, ShapeSpace
from torchhand.track.appearance import Agreement
from torchhand.track.limits import clamp_to_limits
from torchhand.track.state import Estimate, TrackerState

_JOINT_CENTRE_STD = 0.004
"""Metres: two hand models place their joint centres a few millimetres apart under the same skin."""


def estimate_of(
    status: FrameStatus,
    state: TrackerState,
    kinematics: HandKinematics,
    space: PoseSpace,
    camera: Camera,
    shape: Float[Tensor, "shape"],
    *,
    jacobian: PoseJacobian,
    scale_std: float,
    agreement: Agreement,
    found: float,
    nis: float | None = None,
) -> Estimate:
    """The estimate of a frame in which the hand is followed.

    jacobian: of those kinematics in all 36 DOFs.
    scale_std: standard deviation of the hand's size and distance in common, as a share, which no picture of one camera
    tells (`unknown_scale_std`).
    """
    posed = posed_belief(state, kinematics, space, shape, jacobian=jacobian)
    return Estimate(
        status=status,
        pose=posed.pose,
        pose_std=posed.pose_std,
        root_rotation=posed.root_rotation,
        keypoints=posed.keypoints,
        keypoints_px=camera.project(posed.keypoints),
        keypoints_cov=posed.keypoints_cov + _scale_covariance(posed.keypoints, scale_std),
        overlap=agreement.overlap,
        unexplained=agreement.unexplained,
        found=found,
        nis=nis,
    )


@dataclass(frozen=True, kw_only=True)
class PosedBelief:
    """What a belief says of the hand, in the frame that the belief is in."""

    pose: Float[Tensor, "36"]
    """With the root's whole rotation vector; metres and radians."""
    pose_std: Float[Tensor, "36"]
    """0 for DOFs that are held; those of the root's rotation are of a small turn in the frame's axes."""
    root_rotation: Float[Tensor, "3 3"]
    keypoints: Float[Tensor, "21 3"]
    """Metres."""
    keypoints_cov: Float[Tensor, "21 3 3"]
    """Square metres: of the belief, and of joint centres within the flesh, which no filter knows."""


def posed_belief(
    state: TrackerState,
    kinematics: HandKinematics,
    space: PoseSpace,
    shape: Float[Tensor, "shape"],
    *,
    jacobian: PoseJacobian,
) -> PosedBelief:
    """Pose and keypoints of a tracker's state with their covariances, first order.

    jacobian: of those kinematics in all 36 DOFs.
    """
    count = space.size
    space = space.about(state.base)
    covariance = state.belief.covariance[:count, :count]
    mean = state.belief.mean[:count]
    pose = clamp_to_limits(space.dof(mean), kinematics.skeleton)
    moving = pose == space.dof(mean)  # a tied angle may have stopped at its limit
    basis = moving[:, None] * space.basis
    frames = kinematics(pose, shape, root_reference=state.reference)
    columns = jacobian(pose, frames) @ basis  # 21 3 free
    rotation = rotation_from_vector(pose[3:6]) @ state.reference
    eye = torch.eye(3, dtype=pose.dtype)
    return PosedBelief(
        pose=torch.cat((pose[:3], vector_from_rotation(rotation), pose[6:])),
        pose_std=(basis @ covariance @ basis.T).diagonal().clamp_min(0).sqrt(),
        root_rotation=rotation,
        keypoints=frames.keypoints,
        keypoints_cov=columns @ covariance @ columns.mT + _JOINT_CENTRE_STD**2 * eye,
    )


def unknown_scale_std(space: ShapeSpace, camera: Camera, *, is_shape_known: bool) -> float:
    """Spread over people of the hand's length, as a share, where it decides the distance and was not measured."""
    if is_shape_known or camera.kind == "orthographic":
        return 0.0
    index = space.names.index("hand_length")
    return float(space.std[index] / space.default[index])


def _scale_covariance(keypoints: Float[Tensor, "21 3"], scale_std: float) -> Float[Tensor, "21 3 3"]:
    """What scale adds where hand length is not measured."""
    return scale_std**2 * (keypoints[:, :, None] * keypoints[:, None, :])
