"""Pieces of a mask: connected components, holes, cleaning."""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor

from torchhand.image.operations import (
    bounding_box,
    closed,
    count_pieces,
    disc_kernel,
    label_pieces,
    numbered_pieces,
    opened,
)


@dataclass(frozen=True, kw_only=True)
class Component:
    """One connected piece (8 neighbours) of a mask."""

    label: int
    """Number of the component in `label_pieces`, from 1."""
    area_px: int
    left: int
    top: int
    width: int
    height: int
    """Smallest rectangle around it, in whole pixels."""
    centroid: tuple[float, float]
    """Mean (x, y) of its pixel centres, px."""


def components(mask: Bool[Tensor, "height width"], min_area: int = 1) -> list[Component]:
    """Pieces of at least `min_area` pixels, the largest first."""
    pieces = label_pieces(mask)
    found = []
    numbers = zip(pieces.boxes.tolist(), pieces.areas.tolist(), pieces.centroids.tolist(), strict=True)
    for label, ((left, top, wide, high), area, (x, y)) in enumerate(numbers, 1):
        if area < min_area:
            continue
        found.append(
            Component(
                label=label,
                area_px=area,
                left=left,
                top=top,
                width=wide,
                height=high,
                centroid=(x, y),
            )
        )
    return sorted(found, key=lambda piece: (-piece.area_px, piece.label))


def largest_component(mask: Bool[Tensor, "height width"]) -> Bool[Tensor, "height width"]:
    """The piece with most pixels; an empty mask stays empty."""
    left, top, width, height = bounding_box(mask)
    box = (slice(top, top + height), slice(left, left + width))
    if not width or count_pieces(mask[box]) == 1:
        return mask.clone()
    kept, pieces = torch.zeros_like(mask), label_pieces(mask[box])
    largest = (pieces.areas == pieces.areas.max()).nonzero()[0, 0]  # the first of equals
    kept[box] = pieces.labels == largest + 1
    return kept


def fill_holes(mask: Bool[Tensor, "height width"], max_area: int | None = None) -> Bool[Tensor, "height width"]:
    """Mask with the background regions that do not reach the picture's border (4 neighbours) filled.

    With `max_area` only holes of up to so many pixels: a ring of thumb and finger keeps its hole.
    """
    filled = mask.clone()
    left, top, width, height = bounding_box(mask)  # a hole lies inside the mask's box
    box = filled[top : top + height, left : left + width]
    around = torch.nn.functional.pad(~box, (1, 1, 1, 1), value=True)
    if not width or count_pieces(around, connectivity=4) == 1:
        return filled
    pieces = label_pieces(~box, connectivity=4)
    first_x, first_y, wide, high = pieces.boxes.unbind(-1)
    is_hole = (first_x > 0) & (first_y > 0) & (first_x + wide < width) & (first_y + high < height)
    if max_area is not None:
        is_hole &= pieces.areas <= max_area
    if bool(is_hole.any()):
        box |= _chosen(is_hole)[pieces.labels.long()]
    return filled


def touching(mask: Bool[Tensor, "height width"], other: Bool[Tensor, "height width"]) -> Bool[Tensor, "height width"]:
    """The connected pieces (8 neighbours) of a mask that share a pixel with another mask."""
    labels, count = numbered_pieces(mask)
    if count == 1:  # as in most pictures of a hand
        return mask.clone() if bool((mask & other).any()) else torch.zeros_like(mask)
    is_met = torch.zeros(count + 1, dtype=torch.bool, device=mask.device)
    is_met[labels[other].long()] = True
    is_met[0] = False
    return is_met.index_select(0, labels.flatten()).reshape(mask.shape)


def clean(mask: Bool[Tensor, "height width"], radius_px: int | None = None) -> Bool[Tensor, "height width"]:
    """Specks and slits removed: opening, then closing, by a disc of `radius_px`.

    Left out, the radius follows the picture: 1 px per 320 px of its longer side (rounded, at least 1). The
    picture's border neither removes nor adds anything.
    """
    radius = max(1, round(max(mask.shape) / 320)) if radius_px is None else radius_px
    if radius < 0:
        raise ValueError(f"clean: radius_px must be >= 0, got {radius}")
    if radius == 0:
        return mask.clone()
    return closed(opened(mask, disc_kernel(radius)), disc_kernel(radius))


def _chosen(pieces: Bool[Tensor, "pieces"]) -> Bool[Tensor, "labels"]:
    """Whether a label is that of a chosen piece; 0, beside the mask, is not."""
    return torch.nn.functional.pad(pieces, (1, 0))


def solidity(mask: Bool[Tensor, "height width"]) -> float:
    """Area over that of the convex hull: 1 for what is convex, less for what has dents; 0 for an empty mask."""
    rows, columns = mask.cpu().nonzero(as_tuple=True)
    if not len(rows):
        return 0.0
    corners = torch.stack((columns, rows), -1)[:, None].to(torch.int32).numpy()
    hull = cv2.convexHull(corners)
    filled = np.zeros(mask.shape, dtype=np.uint8)
    cv2.fillConvexPoly(filled, hull, 1)
    return float(mask.sum()) / float(filled.sum())
