"""Picture to measurement: skin, silhouettes, moments, colour models, edges along normals. Knows no hand."""

from torchhand.image.background import BackgroundPlate, background_mask, chroma_mask, learn_background
from torchhand.image.colours import ColourModel, foreground_probability, learn_colours, luminance, relearn_colours
from torchhand.image.components import (
    Component,
    clean,
    component_mask,
    components,
    fill_holes,
    largest_component,
    touching,
)
from torchhand.image.distance_fields import (
    Boundary,
    DistanceField,
    boundary_field,
    boundary_points,
    channel_of,
    point_field,
)
from torchhand.image.distance_maps import depth_map, distance_map
from torchhand.image.edges import EdgeSearch, EdgeSettings, search_edges
from torchhand.image.fingers import FingerSettings, find_fingers, opened_by_disc
from torchhand.image.hand_regions import HandRegions, NoRegions, divide_hand
from torchhand.image.moments import MaskMoments, mask_moments
from torchhand.image.morphology import (
    binomial_blur,
    closed,
    cross_kernel,
    dilate,
    disc_kernel,
    erode,
    gaussian_blur,
    gradient,
    label_pieces,
    opened,
    square_kernel,
)
from torchhand.image.overlaps import hand_region, intersection_over_union
from torchhand.image.reduction import reduced, reduced_mask
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
    "binomial_blur",
    "bootstrap_skin",
    "boundary_field",
    "boundary_points",
    "channel_of",
    "chroma_mask",
    "clean",
    "closed",
    "component_mask",
    "components",
    "cross_kernel",
    "depth_map",
    "dilate",
    "disc_kernel",
    "distance_map",
    "divide_hand",
    "erode",
    "fill_holes",
    "find_fingers",
    "find_open_hand",
    "find_valleys",
    "foreground_probability",
    "gaussian_blur",
    "gradient",
    "hand_region",
    "intersection_over_union",
    "is_inside",
    "label_pieces",
    "largest_component",
    "learn_background",
    "learn_colours",
    "learn_skin",
    "luminance",
    "mask_moments",
    "opened",
    "opened_by_disc",
    "otsu_cr_mask",
    "point_field",
    "reduced",
    "reduced_mask",
    "refine_silhouette",
    "relearn_colours",
    "sample_bilinear",
    "search_edges",
    "segment",
    "skin_probability",
    "square_kernel",
    "touching",
]
