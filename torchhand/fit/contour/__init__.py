"""The contours of a picture as an observation (Ouhaddi and Horain 1998, section 7): distance maps and valleys; and
edges along normals (Stenger et al. 2001)."""

from torchhand.fit.contour.edges import EDGE_REACH, EDGES, EdgeFactor, EdgeObservation
from torchhand.fit.contour.observation import CONTOUR, NEAR_M, ContourFactor, ContourObservation
from torchhand.fit.contour.picture import PictureContours, picture_contours
from torchhand.fit.contour.points import hand_length_px, is_in_picture, is_outer, pixels_per_metre
from torchhand.fit.contour.restarts import Restarts, RestartSettings, solve_with_restarts
from torchhand.fit.contour.settings import (
    QUICK_SEARCH,
    SEARCH,
    THIN_SEARCH,
    TRACKING,
    WHOLE_SEARCH,
    WIDE_SEARCH,
    ContourSettings,
)

__all__ = [
    "CONTOUR",
    "EDGES",
    "EDGE_REACH",
    "NEAR_M",
    "QUICK_SEARCH",
    "SEARCH",
    "THIN_SEARCH",
    "TRACKING",
    "WHOLE_SEARCH",
    "WIDE_SEARCH",
    "ContourFactor",
    "ContourObservation",
    "ContourSettings",
    "EdgeFactor",
    "EdgeObservation",
    "PictureContours",
    "RestartSettings",
    "Restarts",
    "hand_length_px",
    "is_in_picture",
    "is_outer",
    "picture_contours",
    "pixels_per_metre",
    "solve_with_restarts",
]
