"""The mesh of a hand, and how bones and angles move it."""

from torchhand.hand.skin.mesh import HandMesh
from torchhand.hand.skin.skinning import Skinning, mirrored_mesh

__all__ = [
    "HandMesh",
    "Skinning",
    "mirrored_mesh",
]
