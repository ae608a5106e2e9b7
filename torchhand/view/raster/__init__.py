"""What pixels show of a hand: rays cast at its primitives, triangles drawn with depth."""

from torchhand.view.raster.raster import mesh_silhouette, rasterize
from torchhand.view.raster.raycast import Raycast, raycast, shade
from torchhand.view.raster.surface import Surface, cast, silhouette

__all__ = [
    "Raycast",
    "Surface",
    "cast",
    "mesh_silhouette",
    "rasterize",
    "raycast",
    "shade",
    "silhouette",
]
