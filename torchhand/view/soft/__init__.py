"""Pictures that can be differentiated through: silhouettes, depth and keypoint maps."""

from torchhand.view.soft.keypoint_maps import keypoint_maps
from torchhand.view.soft.primitive_mesh import primitive_mesh
from torchhand.view.soft.renderer import SoftPicture, SoftRenderer

__all__ = [
    "SoftPicture",
    "SoftRenderer",
    "keypoint_maps",
    "primitive_mesh",
]
