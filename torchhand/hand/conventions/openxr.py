"""The 26 hand joints of OpenXR (XR_EXT_hand_tracking): their order, poses and radii, and the way back to ours.

Axes of a joint, for either hand: -z along the bone towards the fingertip, +y out of the back of the hand, +x to the
right. A joint stands at the end of its bone that is nearer to the wrist and is named after the bone; a tip stands at
the fingertip with the axes of the last bone; the palm stands in the middle of the middle finger's metacarpal. Without
palm and the four fingers' metacarpals the order is that of our 21 keypoints.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.hand.conventions.bone_fit import BoneFit, fit_bones
from torchhand.hand.kinematics import BONES, FINGERS, HandFrames, HandKinematics, ShapeSpace
from torchhand.precision import own_precision

OPENXR_JOINTS = (
    "palm",
    "wrist",
    *(f"thumb_{part}" for part in ("metacarpal", "proximal", "distal", "tip")),
    *(
        f"{finger}_{part}"
        for finger in FINGERS[1:]
        for part in ("metacarpal", "proximal", "intermediate", "distal", "tip")
    ),
)
"""In the order of XrHandJointEXT."""

OPENXR_KEYPOINTS = tuple(
    i for i, name in enumerate(OPENXR_JOINTS) if name != "palm" and (name[:5] == "thumb" or name[-10:] != "metacarpal")
)
"""The joints that are our 21 keypoints, in their order."""

_OUR_NAMES = {name: name.replace("intermediate", "middle").replace("tip", "distal") for name in OPENXR_JOINTS}
_OUR_NAMES["palm"] = "middle_metacarpal"
_BONE_OF_JOINT = tuple(BONES.index(_OUR_NAMES[name]) for name in OPENXR_JOINTS)


@dataclass(frozen=True, kw_only=True)
class OpenXRJoints:
    """Where the 26 joints are, in the frame of the bones they were made of."""

    position: Float[Tensor, "*batch 26 3"]
    """Positions of the joints, metres."""
    rotation: Float[Tensor, "*batch 26 3 3"]
    """world_from_joint"""


@own_precision
def openxr_joints(frames: HandFrames) -> OpenXRJoints:
    """The joints of posed bones. Our fingertip keypoints lie 3 mm under the skin, and so do the tips."""
    axes = _bone_from_joint(frames.rotation)
    index = list(_BONE_OF_JOINT)
    position = frames.position[..., index, :].clone()
    bone = BONES.index("middle_metacarpal")
    position[..., 0, :] = 0.5 * (frames.position[..., bone, :] + frames.position[..., bone + 5, :])
    position[..., list(OPENXR_KEYPOINTS), :] = frames.keypoints
    return OpenXRJoints(position=position, rotation=frames.rotation[..., index, :, :] @ axes)


@own_precision
def pose_of_openxr(kinematics: HandKinematics, joints: OpenXRJoints) -> BoneFit:
    """Our pose of the joints' orientations and the wrist's place; the hand's proportions are the caller's."""
    index = [_joint_of(bone) for bone in BONES]
    rotation = joints.rotation[..., index, :, :] @ _bone_from_joint(joints.rotation).mT
    return fit_bones(kinematics, rotation, joints.position[..., OPENXR_JOINTS.index("wrist"), :])


@own_precision
def openxr_radii(space: ShapeSpace, shape: Float[Tensor, "*batch shape"]) -> Float[Tensor, "*batch 26"]:
    """Distance from each joint to the skin, metres; in the palm half its thickness."""
    metres = space.metric(shape)
    palm = 0.5 * metres["palm_thickness"]
    radii = {"palm": palm, "wrist": palm, "thumb_metacarpal": metres["thumb_thenar_radius"]}
    joints = {"proximal": "mcp", "intermediate": "pip", "distal": "dip", "tip": "tip"}
    for name in OPENXR_JOINTS:
        finger, _, part = name.partition("_")
        joint = "ip" if name == "thumb_distal" else joints.get(part, "")
        radii.setdefault(name, metres[f"{finger}_{joint}_radius"] if joint else palm)
    return torch.stack([radii[name] for name in OPENXR_JOINTS], -1)


def _joint_of(bone: str) -> int:
    finger, _, part = bone.partition("_")
    return OPENXR_JOINTS.index(f"{finger}_intermediate" if part == "middle" else bone)


def _bone_from_joint(like: Tensor) -> Float[Tensor, "3 3"]:
    """Our bones have y to the fingertip, x out of the back of the hand, z to the left, for either hand."""
    rows = ((0.0, 1.0, 0.0), (0.0, 0.0, -1.0), (-1.0, 0.0, 0.0))
    return torch.tensor(rows, dtype=like.dtype, device=like.device)
