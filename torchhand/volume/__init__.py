"""Octrees carved from the silhouettes of several cameras, and the distance field of their hulls. Knows no hand."""

from torchhand.volume.carving import Carver, carve
from torchhand.volume.carving_settings import CarvingSettings
from torchhand.volume.cube import RootCube, common_volume, root_cube
from torchhand.volume.field import HullField, distance_grid, hull_field
from torchhand.volume.octree import BLACK, GRAY, UNKNOWN, WHITE, Leaves, Octree, OctreeLevel, places_of
from torchhand.volume.picture import draw_hull
from torchhand.volume.surface import hull_mesh, hull_quads

__all__ = [
    "BLACK",
    "GRAY",
    "UNKNOWN",
    "WHITE",
    "Carver",
    "CarvingSettings",
    "HullField",
    "Leaves",
    "Octree",
    "OctreeLevel",
    "RootCube",
    "carve",
    "common_volume",
    "distance_grid",
    "draw_hull",
    "hull_field",
    "hull_mesh",
    "hull_quads",
    "places_of",
    "root_cube",
]
