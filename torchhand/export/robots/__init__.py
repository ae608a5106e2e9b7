"""Hands as robots: URDF and MJCF with a closed solid for each link."""

from torchhand.export.robots.joint_file import JOINTS_SUFFIX, clip_of_joints, write_joints
from torchhand.export.robots.link_solids import LinkSolid, link_solids
from torchhand.export.robots.meshes import meshes_folder
from torchhand.export.robots.mjcf import MjcfSettings, write_mjcf
from torchhand.export.robots.teleoperation import (
    WristAxes,
    WristPoints,
    teleoperation_message,
    wrist_points,
    write_teleoperation,
)
from torchhand.export.robots.urdf import srdf_path, write_urdf

__all__ = [
    "JOINTS_SUFFIX",
    "LinkSolid",
    "MjcfSettings",
    "WristAxes",
    "WristPoints",
    "clip_of_joints",
    "link_solids",
    "meshes_folder",
    "srdf_path",
    "teleoperation_message",
    "wrist_points",
    "write_joints",
    "write_mjcf",
    "write_teleoperation",
    "write_urdf",
]
