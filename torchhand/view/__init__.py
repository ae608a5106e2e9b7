"""Hand and camera in, what the camera should see out: outlines, visibility, ray-cast pictures."""

from torchhand.view.outline import Outline, OutlineTable, outline, outline_table, pixel_normals
from torchhand.view.projector import Contour, HandProjector
from torchhand.view.raycast import Raycast, raycast, shade
from torchhand.view.visibility import inside_any, visible_points

__all__ = [
    "Contour",
    "HandProjector",
    "Outline",
    "OutlineTable",
    "Raycast",
    "inside_any",
    "outline",
    "outline_table",
    "pixel_normals",
    "raycast",
    "shade",
    "visible_points",
]
