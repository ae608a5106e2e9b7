"""Picture to measurement: skin, silhouettes, moments, colour models, edges along normals. Knows no hand."""

from torchhand.image.background import BackgroundPlate, background_mask, chroma_mask, learn_background
from torchhand.image.colours import ColourModel, foreground_probability, learn_colours
from torchhand.image.components import Component, clean, component_mask, components, fill_holes, largest_component
from torchhand.image.edges import EdgeSearch, EdgeSettings, search_edges
from torchhand.image.moments import MaskMoments, mask_moments
from torchhand.image.sampling import is_inside, sample_bilinear
from torchhand.image.silhouette import SilhouetteSettings, segment
from torchhand.image.skin import SkinModel, learn_skin, skin_probability
from torchhand.image.skin_start import CrSplit, SkinStart, bootstrap_skin, otsu_cr_mask

__all__ = [
    "BackgroundPlate",
    "ColourModel",
    "Component",
    "CrSplit",
    "EdgeSearch",
    "EdgeSettings",
    "MaskMoments",
    "SilhouetteSettings",
    "SkinModel",
    "SkinStart",
    "background_mask",
    "bootstrap_skin",
    "chroma_mask",
    "clean",
    "component_mask",
    "components",
    "fill_holes",
    "foreground_probability",
    "is_inside",
    "largest_component",
    "learn_background",
    "learn_colours",
    "learn_skin",
    "mask_moments",
    "otsu_cr_mask",
    "sample_bilinear",
    "search_edges",
    "segment",
    "skin_probability",
]
