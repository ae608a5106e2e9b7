"""Which pixels show a hand: colour models, skin, backgrounds, masks and their components."""

from torchhand.image.segmentation.background import BackgroundPlate, background_mask, chroma_mask, learn_background
from torchhand.image.segmentation.colours import (
    ColourModel,
    foreground_probability,
    learn_colours,
    luminance,
    relearn_colours,
)
from torchhand.image.segmentation.components import (
    Component,
    clean,
    components,
    fill_holes,
    largest_component,
    solidity,
    touching,
)
from torchhand.image.segmentation.graph_cut import cut_along_edges, graph_cut
from torchhand.image.segmentation.light import Light
from torchhand.image.segmentation.silhouette import SilhouetteSettings, segment
from torchhand.image.segmentation.skin import SkinModel, learn_skin, skin_probability
from torchhand.image.segmentation.skin_candidates import skin_candidates
from torchhand.image.segmentation.skin_start import (
    GREY,
    CrSplit,
    SkinStart,
    bootstrap_skin,
    is_grey,
    mean_skin_likeness,
    otsu_cr_mask,
)

__all__ = [
    "GREY",
    "BackgroundPlate",
    "ColourModel",
    "Component",
    "CrSplit",
    "Light",
    "SilhouetteSettings",
    "SkinModel",
    "SkinStart",
    "background_mask",
    "bootstrap_skin",
    "chroma_mask",
    "clean",
    "components",
    "cut_along_edges",
    "fill_holes",
    "foreground_probability",
    "graph_cut",
    "is_grey",
    "largest_component",
    "learn_background",
    "learn_colours",
    "learn_skin",
    "luminance",
    "mean_skin_likeness",
    "otsu_cr_mask",
    "relearn_colours",
    "segment",
    "skin_candidates",
    "skin_probability",
    "solidity",
    "touching",
]
