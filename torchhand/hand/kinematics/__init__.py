"""Bones, angles and proportions: the skeleton, pose and shape spaces, forward kinematics and its derivatives."""

from torchhand.hand.kinematics.chain import place_chain
from torchhand.hand.kinematics.compiled import place_chain_plainly
from torchhand.hand.kinematics.constants import FREE_BONES, HINGES, LEVER_ENDS
from torchhand.hand.kinematics.hand_pose import HandPose
from torchhand.hand.kinematics.jacobians import (
    KEYPOINT_BONES,
    PoseJacobian,
    ShapeJacobian,
    keypoint_jacobian,
    moving_parameters,
)
from torchhand.hand.kinematics.joint_rotations import world_axes
from torchhand.hand.kinematics.kinematics import HandFrames, HandKinematics, Side
from torchhand.hand.kinematics.pose import (
    POSE_SPACES,
    POSTURES,
    PoseSpace,
    named_pose_space,
    pose_space,
    posture,
    rebased,
)
from torchhand.hand.kinematics.shape import TIP_DEPTH, ShapeSpace, bone_offsets, joint_positions, linear_map
from torchhand.hand.kinematics.sided_skeleton import sided_skeleton
from torchhand.hand.kinematics.skeleton import (
    BONES,
    DOFS,
    FINGER_CHAINS,
    FINGERS,
    JOINT_DOFS,
    KEYPOINTS,
    KNUCKLES,
    PALM,
    PARENTS,
    ROOT_DOFS,
    TIPS,
    Skeleton,
)

__all__ = [
    "BONES",
    "DOFS",
    "FINGERS",
    "FINGER_CHAINS",
    "FREE_BONES",
    "HINGES",
    "JOINT_DOFS",
    "KEYPOINTS",
    "KEYPOINT_BONES",
    "KNUCKLES",
    "LEVER_ENDS",
    "PALM",
    "PARENTS",
    "POSE_SPACES",
    "POSTURES",
    "ROOT_DOFS",
    "TIPS",
    "TIP_DEPTH",
    "HandFrames",
    "HandKinematics",
    "HandPose",
    "PoseJacobian",
    "PoseSpace",
    "ShapeJacobian",
    "ShapeSpace",
    "Side",
    "Skeleton",
    "bone_offsets",
    "joint_positions",
    "keypoint_jacobian",
    "linear_map",
    "moving_parameters",
    "named_pose_space",
    "place_chain",
    "place_chain_plainly",
    "pose_space",
    "posture",
    "rebased",
    "sided_skeleton",
    "world_axes",
]
