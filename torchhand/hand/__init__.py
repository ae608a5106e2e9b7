"""The hand as torch modules: skeleton, shape, pose spaces, kinematics, primitives, skinned mesh, constraints, prior."""

from torchhand.hand.anthropometry import MEASURES, Anthropometry, AnthropometrySettings
from torchhand.hand.constraints import ConstraintSettings, PoseConstraints
from torchhand.hand.hand import Hand, HandState
from torchhand.hand.jacobians import (
    KEYPOINT_BONES,
    PoseJacobian,
    ShapeJacobian,
    keypoint_jacobian,
    moving_parameters,
    shape_jacobian,
)
from torchhand.hand.kinematics import HandFrames, HandKinematics, Side
from torchhand.hand.mesh import HandMesh
from torchhand.hand.model import HandModel
from torchhand.hand.penetration import Penetration, PenetrationSettings, penetration, penetration_penalty
from torchhand.hand.pose import POSE_SPACES, POSTURES, PoseSpace, named_pose_space, pose_space, posture, rebased
from torchhand.hand.posed_mesh import PosedMesh, posed_mesh
from torchhand.hand.posture_mixture import PostureMixture
from torchhand.hand.primitives import (
    CONE_NAMES,
    ELLIPSOID_NAMES,
    PRIMITIVE_NAMES,
    Implicit,
    Primitives,
    PrimitiveSizes,
    place_primitives,
)
from torchhand.hand.prior import HandPrior, HandPriorSettings
from torchhand.hand.prior_components import PostureComponent, posture_component
from torchhand.hand.prior_postures import COMPONENTS
from torchhand.hand.shape import ShapeSpace, bone_offsets
from torchhand.hand.sizing import primitive_sizes
from torchhand.hand.skeleton import BONES, DOFS, FINGERS, JOINT_DOFS, KEYPOINTS, PARENTS, ROOT_DOFS, Skeleton
from torchhand.hand.skin_jacobian import skin_jacobian
from torchhand.hand.violation import Violation

__all__ = [
    "BONES",
    "COMPONENTS",
    "CONE_NAMES",
    "DOFS",
    "ELLIPSOID_NAMES",
    "FINGERS",
    "JOINT_DOFS",
    "KEYPOINTS",
    "KEYPOINT_BONES",
    "MEASURES",
    "PARENTS",
    "POSE_SPACES",
    "POSTURES",
    "PRIMITIVE_NAMES",
    "ROOT_DOFS",
    "Anthropometry",
    "AnthropometrySettings",
    "ConstraintSettings",
    "Hand",
    "HandFrames",
    "HandKinematics",
    "HandMesh",
    "HandModel",
    "HandPrior",
    "HandPriorSettings",
    "HandState",
    "Implicit",
    "Penetration",
    "PenetrationSettings",
    "PoseConstraints",
    "PoseJacobian",
    "PoseSpace",
    "PosedMesh",
    "PostureComponent",
    "PostureMixture",
    "PrimitiveSizes",
    "Primitives",
    "ShapeJacobian",
    "ShapeSpace",
    "Side",
    "Skeleton",
    "Violation",
    "bone_offsets",
    "keypoint_jacobian",
    "moving_parameters",
    "named_pose_space",
    "penetration",
    "penetration_penalty",
    "place_primitives",
    "pose_space",
    "posed_mesh",
    "posture",
    "posture_component",
    "primitive_sizes",
    "rebased",
    "shape_jacobian",
    "skin_jacobian",
]
