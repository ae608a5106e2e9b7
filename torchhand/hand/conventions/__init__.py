"""Poses in the words of others: MANO, OpenXR, MPEG-4 body animation parameters and H-Anim."""

from torchhand.hand.conventions.baps import LARGEST_ID, NUMBERINGS, Numbering, bap_ids, baps_of_pose, pose_of_baps
from torchhand.hand.conventions.bone_fit import BoneFit, fit_bones
from torchhand.hand.conventions.bone_turns import bone_rotations, bone_turns
from torchhand.hand.conventions.hanim import hanim_joints, hanim_segments
from torchhand.hand.conventions.mano import (
    MANO_JOINTS,
    ManoPose,
    mano_from_hand,
    mano_of_pose,
    pose_of_mano,
    rest_rotations,
)
from torchhand.hand.conventions.openxr import OPENXR_JOINTS, OpenXRJoints, openxr_joints, openxr_radii, pose_of_openxr

__all__ = [
    "LARGEST_ID",
    "MANO_JOINTS",
    "NUMBERINGS",
    "OPENXR_JOINTS",
    "BoneFit",
    "ManoPose",
    "Numbering",
    "OpenXRJoints",
    "bap_ids",
    "baps_of_pose",
    "bone_rotations",
    "bone_turns",
    "fit_bones",
    "hanim_joints",
    "hanim_segments",
    "mano_from_hand",
    "mano_of_pose",
    "openxr_joints",
    "openxr_radii",
    "pose_of_baps",
    "pose_of_mano",
    "pose_of_openxr",
    "rest_rotations",
]
