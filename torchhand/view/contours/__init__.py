"""Points of the contour that move with the pose, and their derivatives, of primitives and of meshes."""

from torchhand.view.contours.contours import ContourLook, ContourMotion, Contours, HandContourMotion, PrimitiveContours
from torchhand.view.contours.mesh_contours import MeshContours
from torchhand.view.contours.seen_bones import BonePlacer
from torchhand.view.contours.springs import Springs

__all__ = [
    "BonePlacer",
    "ContourLook",
    "ContourMotion",
    "Contours",
    "HandContourMotion",
    "MeshContours",
    "PrimitiveContours",
    "Springs",
]
