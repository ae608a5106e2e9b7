"""Hands as robots: URDF and MJCF with a closed solid for each link."""

from torchhand.export.robots.link_solids import LinkSolid, link_solids
from torchhand.export.robots.meshes import meshes_folder
from torchhand.export.robots.mjcf import write_mjcf
from torchhand.export.robots.urdf import write_urdf

__all__ = [
    "LinkSolid",
    "link_solids",
    "meshes_folder",
    "write_mjcf",
    "write_urdf",
]
