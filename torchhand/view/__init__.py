"""Hand and camera in, what the camera should see out: outlines, visibility, ray-cast pictures."""

from torchhand.view.contours import ContourLook, ContourMotion, Contours, PrimitiveContours
from torchhand.view.mesh_contours import MeshContours
from torchhand.view.outline import Outline, OutlineTable, outline, outline_table, pixel_normals
from torchhand.view.projector import Contour, HandProjector
from torchhand.view.raster import mesh_silhouette, rasterize
from torchhand.view.raycast import Raycast, raycast, shade
from torchhand.view.surface import Surface, cast, silhouette
from torchhand.view.visibility import inside_any, visible_points

__all__ = [
    "Contour",
    "ContourLook",
    "ContourMotion",
    "Contours",
    "HandProjector",
    "MeshContours",
    "Outline",
    "OutlineTable",
    "PrimitiveContours",
    "Raycast",
    "Surface",
    "cast",
    "inside_any",
    "mesh_silhouette",
    "outline",
    "outline_table",
    "pixel_normals",
    "rasterize",
    "raycast",
    "shade",
    "silhouette",
    "visible_points",
]
