"""Hand and camera in, what the camera should see out: outlines, visibility, ray-cast pictures."""

from torchhand.view.contours import ContourMotion, Contours, MeshContours, PrimitiveContours, VisibleContour
from torchhand.view.outlines import (
    Contour,
    HandProjector,
    Outline,
    OutlineTable,
    outline,
    outline_table,
    pixel_normals,
    visible_points,
)
from torchhand.view.raster import (
    Raycast,
    Surface,
    cast,
    mesh_silhouette,
    rasterize,
    rasterize_many,
    raycast,
    shade,
    silhouette,
)
from torchhand.view.soft import SoftPicture, SoftRenderer, keypoint_maps, primitive_mesh

__all__ = [
    "Contour",
    "ContourMotion",
    "Contours",
    "HandProjector",
    "MeshContours",
    "Outline",
    "OutlineTable",
    "PrimitiveContours",
    "Raycast",
    "SoftPicture",
    "SoftRenderer",
    "Surface",
    "VisibleContour",
    "cast",
    "keypoint_maps",
    "mesh_silhouette",
    "outline",
    "outline_table",
    "pixel_normals",
    "primitive_mesh",
    "rasterize",
    "rasterize_many",
    "raycast",
    "shade",
    "silhouette",
    "visible_points",
]
