"""What pixels show of a hand: rays cast at its primitives, triangles drawn with depth."""

from torchhand.view.raster.raster import mesh_silhouette, nearest_faces, rasterize, rasterize_many
from torchhand.view.raster.raycast import Raycast, raycast, shade
from torchhand.view.raster.surface import Surface, cast, silhouette
from torchhand.view.raster.triangles import SeenTriangles

__all__ = [
    "Raycast",
    "SeenTriangles",
    "Surface",
    "cast",
    "mesh_silhouette",
    "nearest_faces",
    "rasterize",
    "rasterize_many",
    "raycast",
    "shade",
    "silhouette",
]
