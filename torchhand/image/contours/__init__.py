"""Edges and boundaries, and the distance maps that are sampled around them."""

from torchhand.image.contours.boundaries import Boundary, boundary_points
from torchhand.image.contours.distance_fields import boundary_field, channel_of, point_field
from torchhand.image.contours.distance_maps import depth_map, distance_map
from torchhand.image.contours.edges import EdgeSearch, EdgeSettings, search_edges
from torchhand.image.contours.sampled_maps import DistanceField
from torchhand.image.contours.sampling import is_inside, sample_bilinear
from torchhand.image.contours.valleys import Valleys, ValleySettings, find_valleys, valley_reach
from torchhand.image.contours.windows import Window

__all__ = [
    "Boundary",
    "DistanceField",
    "EdgeSearch",
    "EdgeSettings",
    "ValleySettings",
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
    "valley_reach",
]
