"""Picture to measurement: skin, silhouettes, moments, colour models, edges along normals. Knows no hand."""

from torchhand.image.background import BackgroundPlate, background_mask, chroma_mask, learn_background
from torchhand.image.colours import ColourModel, foreground_probability, learn_colours, relearn_colours
from torchhand.image.components import Component, clean, component_mask, components, fill_holes, largest_component
from torchhand.image.distance_fields import (
    Boundary,
    DistanceField,
    boundary_field,
    boundary_points,
    channel_of,
    point_field,
)
from torchhand.image.distance_maps import distance_map
from torchhand.image.edges import EdgeSearch, EdgeSettings, search_edges
from torchhand.image.fingers import FingerSettings, find_fingers
from torchhand.image.hand_regions import HandRegions, NoRegions, divide_hand
from torchhand.image.moments import MaskMoments, mask_moments
from torchhand.image.refinement import RefinementSettings, find_open_hand, refine_silhouette
from torchhand.image.sampling import is_inside, sample_bilinear
from torchhand.image.silhouette import SilhouetteSettings, segment
from torchhand.image.skin import SkinModel, learn_skin, skin_probability
from torchhand.image.skin_start import CrSplit, SkinStart, bootstrap_skin, otsu_cr_mask
from torchhand.image.valleys import Valleys, ValleySettings, find_valleys

__all__ = [
    "BackgroundPlate",
    "Boundary",
    "ColourModel",
    "Component",
    "CrSplit",
    "DistanceField",
    "EdgeSearch",
    "EdgeSettings",
    "FingerSettings",
    "HandRegions",
    "MaskMoments",
    "NoRegions",
    "RefinementSettings",
    "SilhouetteSettings",
    "SkinModel",
    "SkinStart",
    "ValleySettings",
    "Valleys",
    "background_mask",
    "bootstrap_skin",
    "boundary_field",
    "boundary_points",
    "channel_of",
    "chroma_mask",
    "clean",
    "component_mask",
    "components",
    "distance_map",
    "divide_hand",
    "fill_holes",
    "find_fingers",
    "find_open_hand",
    "find_valleys",
    "foreground_probability",
    "is_inside",
    "largest_component",
    "learn_background",
    "learn_colours",
    "learn_skin",
    "mask_moments",
    "otsu_cr_mask",
    "point_field",
    "refine_silhouette",
    "relearn_colours",
    "sample_bilinear",
    "search_edges",
    "segment",
    "skin_probability",
]
