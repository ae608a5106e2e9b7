"""Skinned hands for viewers: glTF and X3D."""

from torchhand.export.rigged.driven_glb import write_driven_glb
from torchhand.export.rigged.glb import write_glb
from torchhand.export.rigged.glb_rig import GlbSkeleton
from torchhand.export.rigged.x3d import X3DSkin, write_x3d

__all__ = [
    "GlbSkeleton",
    "X3DSkin",
    "write_driven_glb",
    "write_glb",
    "write_x3d",
]
