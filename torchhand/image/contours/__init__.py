"""Edges and boundaries, and the distance maps that are sampled around them."""

from torchhand.image.contours.boundaries import Boundary, boundary_points
from torchhand.image.contours.distance_fields import boundary_field, channel_of, point_field
from torchhand.image.contours.distance_maps import depth_map, distance_map
from torchhand.image.contours.edges import EdgeSearch, EdgeSettings, search_edges
from torchhand.image.contours.sampled_maps import DistanceField
from torchhand.image.contours.sampling import is_inside, sample_bilinear
from torchhand.image.contours.valleys import VALLEY_REACH_PX, Valleys, find_valleys
from torchhand.image.contours.windows import Window

__all__ = [
    "VALLEY_REACH_PX",
    "Boundary",
    "DistanceField",
    "EdgeSearch",
    "EdgeSettings",
    "Valleys",
    "Window",
    "boundary_field",
    "boundary_points",
    "channel_of",
    "depth_map",
    "distance_map",
    "find_valleys",
    "is_inside",
    "point_field",
    "sample_bilinear",
    "search_edges",
]
