"""How far poses are from a reference pose of the same hand: in joint angles, in space, and in orientation."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.geometry import rotation_from_vector
from torchhand.hand import HandKinematics

_ROOT = 6


@dataclass(frozen=True, kw_only=True)
class PoseErrors:
    """One number per pose."""

    angle_deg: Float[Tensor, "*batch"]
    """Mean absolute error of the joint angles that were looked at, degrees."""
    keypoint_mm: Float[Tensor, "*batch"]
    """Mean distance of the 21 keypoints, mm."""
    rotation_deg: Float[Tensor, "*batch"]
    """Angle between the hands' orientations, degrees."""


def pose_errors(
    kinematics: HandKinematics,
    shape: Float[Tensor, "shape"],
    pose: Float[Tensor, "*batch 36"],
    root_reference: Float[Tensor, "*batch 3 3"],
    true_pose: Float[Tensor, "36"],
    true_reference: Float[Tensor, "3 3"],
    joints: Bool[Tensor, "30"],
) -> PoseErrors:
    """Rotation vectors turn the references. joints: which angles count, at least one."""
    difference = (pose - true_pose)[..., _ROOT:][..., joints]
    points = kinematics(pose, shape, root_reference=root_reference).keypoints
    truth = kinematics(true_pose, shape, root_reference=true_reference).keypoints
    turned, wanted = (
        rotation_from_vector(one[..., 3:6]) @ reference
        for one, reference in ((pose, root_reference), (true_pose, true_reference))
    )
    # |A - B| = 2√2 sin(angle / 2): keeps its digits near 0, where the trace of AᵀB loses half of them.
    chord = (turned - wanted).flatten(-2).norm(dim=-1) / (2 * math.sqrt(2))
    return PoseErrors(
        angle_deg=torch.rad2deg(difference.abs().mean(-1)),
        keypoint_mm=1e3 * (points - truth).norm(dim=-1).mean(-1),
        rotation_deg=torch.rad2deg(2 * chord.clamp_max(1.0).asin()),
    )
