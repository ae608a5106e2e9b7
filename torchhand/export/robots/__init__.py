"""Hands as robots: URDF and MJCF with a closed solid for each link."""

from torchhand.export.robots.link_solids import LinkSolid, link_solids
from torchhand.export.robots.meshes import meshes_folder
from torchhand.export.robots.mjcf import MjcfSettings, write_mjcf
from torchhand.export.robots.urdf import srdf_path, write_urdf

__all__ = [
    "LinkSolid",
    "MjcfSettings",
    "link_solids",
    "meshes_folder",
    "srdf_path",
    "write_mjcf",
    "write_urdf",
]
