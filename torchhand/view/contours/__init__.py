"""Points of the contour that move with the pose, and their derivatives, of primitives and of meshes."""

from torchhand.view.contours.contours import (
    ContourMotion,
    Contours,
    PrimitiveContours,
    VisibleContour,
    varied_shapes,
)
from torchhand.view.contours.mesh_contours import MeshContours
from torchhand.view.contours.seen_bones import BonePlacer
from torchhand.view.contours.terms import PointToLineTerms

__all__ = [
    "BonePlacer",
    "ContourMotion",
    "Contours",
    "MeshContours",
    "PointToLineTerms",
    "PrimitiveContours",
    "VisibleContour",
    "varied_shapes",
]
