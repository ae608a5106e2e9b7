"""The hand as torch modules: skeleton, shape, pose spaces, kinematics, quadric primitives."""

from torchhand.hand.kinematics import HandFrames, HandKinematics, Side
from torchhand.hand.pose import POSE_SPACES, POSTURES, PoseSpace, named_pose_space, pose_space, posture, rebased
from torchhand.hand.primitives import (
    CONE_NAMES,
    ELLIPSOID_NAMES,
    PRIMITIVE_NAMES,
    Implicit,
    Primitives,
    PrimitiveSizes,
    place_primitives,
)
from torchhand.hand.shape import ShapeSpace, bone_offsets
from torchhand.hand.sizing import primitive_sizes
from torchhand.hand.skeleton import BONES, DOFS, FINGERS, JOINT_DOFS, KEYPOINTS, PARENTS, ROOT_DOFS, Skeleton

__all__ = [
    "BONES",
    "CONE_NAMES",
    "DOFS",
    "ELLIPSOID_NAMES",
    "FINGERS",
    "JOINT_DOFS",
    "KEYPOINTS",
    "PARENTS",
    "POSE_SPACES",
    "POSTURES",
    "PRIMITIVE_NAMES",
    "ROOT_DOFS",
    "HandFrames",
    "HandKinematics",
    "Implicit",
    "PoseSpace",
    "PrimitiveSizes",
    "Primitives",
    "ShapeSpace",
    "Side",
    "Skeleton",
    "bone_offsets",
    "named_pose_space",
    "place_primitives",
    "pose_space",
    "posture",
    "primitive_sizes",
    "rebased",
]
