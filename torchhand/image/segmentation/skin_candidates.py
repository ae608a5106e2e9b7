"""Silhouettes that a picture may show of hand and forearm, where nothing is known of its colours but human skin's."""

import math

import cv2
import numpy as np
import torch
from jaxtyping import Bool, UInt8
from torch import Tensor

from torchhand.image.operations import binomial_blur, dilate, erode, square_kernel
from torchhand.image.segmentation.colours import foreground_probability, learn_colours
from torchhand.image.segmentation.components import clean, fill_holes, largest_component
from torchhand.image.segmentation.graph_cut import cut_along_edges
from torchhand.image.segmentation.skin_start import skin_likeness, skin_proposals

_CLUSTERS = (3, 5)  # numbers of colours that a picture is divided into
_MIN_LIKENESS = 0.05  # mean likeness to skin of a cluster
_ROUNDS = 3  # of learning the colours of a piece
_RIM_PX = 2  # mixed colours along an outline
_MIN_AREA, _MAX_AREA = 0.004, 0.85  # share of the picture
_SAME = 0.9  # intersection over union of two pieces that are one
_MAX_HOLE = 0.002  # share of the picture
_MOST_CUT = 6  # pieces that are cut along edges
_MOST = 4  # pieces
_FLOOR_PX = 50  # pixels of skin colour, below which brightness divides nothing


def skin_candidates(
    image: UInt8[Tensor, "height width 3"], *, max_side_px: int = 240
) -> list[Bool[Tensor, "small_height small_width"]]:
    """Distinct pieces that may be hand and bare forearm, in the picture reduced to `max_side_px`: those that are cut
    along the picture's edges first, and of these and of the others large, skin-like ones off the border first.

    Pieces are proposed by skin's hue (as `bootstrap_skin` does), by brightness among what has that hue, and by
    clusters of colour. Each is also given with the colours, brightness included, that it teaches against the rest, and
    the likeliest ones as a graph cut has them, which adds what lies in the shade and takes away a wall of skin's
    colour. Which of them is a hand its shape must tell.
    """
    scale = min(1.0, max_side_px / max(image.shape[:2]))
    pixels = image.cpu().contiguous().numpy()
    if scale < 1:
        pixels = cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    small = torch.from_numpy(pixels)
    found: list[Tensor] = []
    for proposal in (*skin_proposals(small), *_by_brightness(small), *_by_colour(small)):
        piece = largest_component(clean(proposal))
        for one in (piece, _taught(small, piece)):
            area = float(one.float().mean())
            if _MIN_AREA <= area <= _MAX_AREA and all(_overlap(one, other) < _SAME for other in found):
                found.append(one)
    _, likeness = _luma_and_likeness(small)
    likeliest = sorted(found, key=lambda piece: -_merit(piece, likeness))[:_MOST_CUT]
    kept: list[Tensor] = []
    for piece in (*(largest_component(cut_along_edges(small, piece)) for piece in likeliest), *likeliest):
        area = float(piece.float().mean())
        if _MIN_AREA <= area <= _MAX_AREA and all(_overlap(piece, other) < _SAME for other in kept):
            kept.append(piece)
    return kept[:_MOST]


def _merit(piece: Tensor, likeness: np.ndarray) -> float:
    """Likeness to skin summed over the piece, for its size counts as a length, less along the picture's border."""
    border = torch.cat((piece[0], piece[-1], piece[1:-1, 0], piece[1:-1, -1])).float().mean()
    inside = likeness[piece.numpy()]
    return float(inside.mean()) * math.sqrt(inside.size) * (1 - float(border)) ** 3


def _overlap(one: Tensor, other: Tensor) -> float:
    return float((one & other).sum()) / max(1, int((one | other).sum()))


def _taught(image: Tensor, piece: Tensor) -> Tensor:
    """The piece that has the colours of a piece, learned over and over; empty where there is nothing to learn."""
    for _ in range(_ROUNDS):
        inside, outside = erode(piece, square_kernel(_RIM_PX)), ~dilate(piece, square_kernel(_RIM_PX))
        if not bool(inside.any()) or not bool(outside.any()):
            return torch.zeros_like(piece)
        probability = binomial_blur(foreground_probability(image, learn_colours(image, inside, outside)))
        piece = largest_component(clean(probability > 0.5))
    return fill_holes(piece, max_area=max(1, round(_MAX_HOLE * piece.numel())))


def _by_brightness(image: Tensor) -> list[Tensor]:
    """What has skin's hue, divided by Otsu's threshold on brightness, and its brighter part divided again."""
    luma, likeness = _luma_and_likeness(image)
    found, part = [], likeness > 0
    for _ in range(2):
        if int(part.sum()) < _FLOOR_PX:
            break
        threshold, _ = cv2.threshold(luma[part].reshape(-1, 1), 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
        bright = part & (luma > threshold)
        found += [bright, part & ~bright]
        part = bright
    return [torch.from_numpy(one) for one in found]


def _by_colour(image: Tensor) -> list[Tensor]:
    """Clusters in CIELAB (k-means from an even division by brightness) that are like skin in part."""
    luma, likeness = _luma_and_likeness(image)
    blurred = cv2.GaussianBlur(image.numpy(), (3, 3), 0)
    values = cv2.cvtColor(blurred, cv2.COLOR_RGB2LAB).reshape(-1, 3).astype(np.float32)
    rank = luma.ravel().argsort(kind="stable").argsort(kind="stable")
    found = []
    for count in _CLUSTERS:
        start = (rank * count // rank.size).astype(np.int32)[:, None]
        stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 20, 1.0)
        _, labels, _ = cv2.kmeans(values, count, start, stop, 1, cv2.KMEANS_USE_INITIAL_LABELS)
        for label in range(count):
            cluster = labels.reshape(luma.shape) == label
            if cluster.any() and float(likeness[cluster].mean()) >= _MIN_LIKENESS:
                found.append(torch.from_numpy(cluster))
    return found


def _luma_and_likeness(image: Tensor) -> tuple[np.ndarray, np.ndarray]:
    luma, cr, cb = cv2.split(cv2.cvtColor(image.numpy(), cv2.COLOR_RGB2YCrCb))
    return luma, skin_likeness(cr.astype(np.float64), cb.astype(np.float64))
