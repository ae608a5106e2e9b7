"""Contour generators of the primitives, their outlines in the picture and which parts of them are seen."""

from torchhand.view.outlines.contour_visibility import seen_and_outer
from torchhand.view.outlines.generators import generators
from torchhand.view.outlines.outline import (
    Outline,
    OutlineTable,
    lengths_along,
    outline,
    outline_of,
    outline_points,
    outline_table,
    pixel_normals,
)
from torchhand.view.outlines.part_outlines import OutlineColumns, PartOutlines
from torchhand.view.outlines.projector import Contour, Generators, HandProjector, Polygons
from torchhand.view.outlines.visibility import visible_points

__all__ = [
    "Contour",
    "Generators",
    "HandProjector",
    "Outline",
    "OutlineColumns",
    "OutlineTable",
    "PartOutlines",
    "Polygons",
    "generators",
    "lengths_along",
    "outline",
    "outline_of",
    "outline_points",
    "outline_table",
    "pixel_normals",
    "seen_and_outer",
    "visible_points",
]
