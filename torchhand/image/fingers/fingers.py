"""Fingers of an open hand's silhouette by a white top-hat whose disc finds its own size (Ouhaddi and Horain 1998, 6.1).

What an opening by a disc slightly wider than the fingers takes away are the fingers. The disc is found by trying sizes:
openings by exact discs come from distance transforms, so any radius costs the same, and the one under which five
elongated pieces stand out longest is taken. Which pieces are fingers, and which finger each is, follows from how well
places of tips and bases agree with an open hand's, at any angle and scale and for either hand.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.image.contours import depth_map, distance_map
from torchhand.image.fingers.order import FingerOrder, order_fingers
from torchhand.image.operations import count_pieces, dilate, label_pieces, square_kernel
from torchhand.image.segmentation import fill_holes, largest_component

_SLIVER = 0.045  # pieces smaller than this share of the square of the palm's radius are ragged outline
_MAX_ENLARGEMENT = 3.0  # small silhouettes are searched enlarged
_PIECES = 8  # the largest of them are considered
_SOLID = 0.86  # share of its convex hull that a straight piece fills at least
_MIN_BRANCH = 0.4  # two fingers are apart where both reach so much farther, palm radii


@dataclass(frozen=True, kw_only=True)
class FingerSettings:
    """What counts as a finger."""

    smallest_disc: float = 0.14
    """Smallest disc tried, over the radius of the palm (the largest disc within the silhouette); above 0."""
    largest_disc: float = 0.62
    """Largest disc tried, as such a share; below 1."""
    sizes: int = 14
    """Discs tried; 2 or more."""
    work_side_px: int = 320
    """The silhouette's box is searched at this longer side, small ones enlarged up to 3 times; 64 or more."""
    min_elongation: float = 1.15
    """Length over mean width of a piece that can be a finger; above 0."""
    min_length: float = 0.5
    """Smallest length of a finger, over the radius of the palm; above 0."""

    def __post_init__(self) -> None:
        if not 0 < self.smallest_disc < self.largest_disc < 1:
            raise ValueError(
                "FingerSettings: expected 0 < smallest_disc < largest_disc < 1,"
                f" got {self.smallest_disc} and {self.largest_disc}"
            )
        if self.sizes < 2:
            raise ValueError(f"FingerSettings.sizes: expected 2 or more, got {self.sizes}")
        if self.work_side_px < 64:
            raise ValueError(f"FingerSettings.work_side_px: expected 64 or more, got {self.work_side_px}")
        for name in ("min_elongation", "min_length"):
            if not 0 < getattr(self, name) < float("inf"):
                raise ValueError(f"FingerSettings.{name}: expected above 0 and finite, got {getattr(self, name)}")


@dataclass(frozen=True, kw_only=True)
class FingerPiece:
    """One piece that the top-hat left and that has a finger's form; px of the whole picture, (x, y)."""

    tip: tuple[float, float]
    """The piece's point farthest from its base."""
    base: tuple[float, float]
    """Middle of its contact with what the opening kept."""
    width: float
    """Area over length."""
    area: float

    @property
    def length(self) -> float:
        return float(np.hypot(self.tip[0] - self.base[0], self.tip[1] - self.base[1]))


@dataclass(frozen=True, kw_only=True)
class FingerSearch:
    """What the top-hat found in one silhouette."""

    pieces: tuple[FingerPiece, ...]
    """Pieces that have a finger's form, at the disc that was chosen, the largest first."""
    order: FingerOrder | None
    """Order of the pieces, thumb to little; None where none agree with an open hand."""
    disc_radius: float
    """Radius of the disc that was chosen, px; 0 where no disc showed a piece."""
    palm_radius: float
    """Radius of the largest disc within the silhouette that has the fingers around it, px."""
    palm_centre: tuple[float, float]


def find_fingers(mask: Bool[Tensor, "height width"], settings: FingerSettings | None = None) -> FingerSearch:
    """Top-hat at its best size: pieces with a finger's form, and which finger each is.

    The largest piece of the mask, its holes filled, is looked at; the mask should not be empty. Sizes go with the
    palm's, so any resolution will do. Where fewer than five fingers stand out, `order` names those that do.
    """
    settings = FingerSettings() if settings is None else settings
    whole = fill_holes(largest_component(mask.cpu())).numpy().astype(np.uint8)
    left, top, width, height = cv2.boundingRect(whole)
    nothing = FingerSearch(pieces=(), order=None, disc_radius=0.0, palm_radius=0.0, palm_centre=(0.0, 0.0))
    if not width:
        return nothing
    scale = min(_MAX_ENLARGEMENT, settings.work_side_px / max(width, height))
    work = _resized(whole[top : top + height, left : left + width], scale)
    depth = depth_map(torch.from_numpy(work > 0)).numpy()
    best: FingerSearch | None = None
    for palm_radius, palm_centre in _palms(depth):
        for fraction in np.geomspace(settings.smallest_disc, settings.largest_disc, settings.sizes):
            pieces = _pieces(work, depth, float(fraction) * palm_radius, palm_radius, palm_centre, settings)
            order = order_fingers(
                [piece.tip for piece in pieces], [piece.base for piece in pieces], palm_centre, palm_radius
            )
            found = FingerSearch(
                pieces=tuple(pieces),
                order=order,
                disc_radius=float(fraction) * palm_radius,
                palm_radius=palm_radius,
                palm_centre=palm_centre,
            )
            if best is None or _merit(found) > _merit(best):
                best = found
    return nothing if best is None else _in_picture(best, scale, (left, top))


def opened_by_disc(depth: Float[Tensor, "height width"], radius: float) -> Bool[Tensor, "height width"]:
    """Morphological opening of a mask by a Euclidean disc of any radius in px, exact up to the pixel grid.

    Pixels within `radius` of one whose depth within the mask, its distance from the nearest pixel outside, exceeds it:
    erosion and dilation by two distance transforms.
    """
    return distance_map(depth > radius) <= radius


def _resized(box: np.ndarray, scale: float) -> np.ndarray:
    """The silhouette's box at the size of the work, with an empty rim of one pixel."""
    size = (max(1, round(box.shape[1] * scale)), max(1, round(box.shape[0] * scale)))
    how = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR
    return np.pad((cv2.resize(box * 255, size, interpolation=how) > 127).astype(np.uint8), 1)


def _palms(depth: np.ndarray) -> list[tuple[float, tuple[float, float]]]:
    """Radius and centre of the largest discs within the silhouette with distinct centres: one is the palm's.

    A foreshortened forearm can be wider than the palm.
    """
    palms: list[tuple[float, tuple[float, float]]] = []
    left = depth.copy()
    while len(palms) < 2:
        y, x = np.unravel_index(int(left.argmax()), left.shape)
        radius = float(left[y, x])
        if radius < 4.0 or (palms and radius < 0.7 * palms[0][0]):
            break
        palms.append((radius, (float(x), float(y))))
        cv2.circle(left, (int(x), int(y)), round(1.5 * radius), 0.0, -1)
    return palms


def _pieces(
    work: np.ndarray,
    depth: np.ndarray,
    radius: float,
    palm_radius: float,
    palm_centre: tuple[float, float],
    settings: FingerSettings,
) -> list[FingerPiece]:
    """Pieces of the top-hat that have a finger's form, fingers that hang together at their web taken apart."""
    opened = opened_by_disc(torch.from_numpy(depth), radius)
    rest = label_pieces(torch.from_numpy(work > 0) & ~opened)
    grown, labels = dilate(opened, square_kernel(1)).numpy(), rest.labels.numpy()
    areas, boxes = rest.areas.tolist(), rest.boxes.tolist()
    pieces = []
    largest = sorted(range(len(areas)), key=lambda piece: -areas[piece])[:_PIECES]
    for number in largest:
        if areas[number] < _SLIVER * palm_radius**2:
            break
        x, y, wide, high = boxes[number]
        box = (slice(y, y + high), slice(x, x + wide))
        inside = labels[box] == number + 1
        contact = inside & grown[box]
        if not contact.any():
            continue
        centre = np.array(palm_centre) - (x, y)
        for part, its_base in _branches(inside, contact, centre, palm_radius):
            piece = _measured(part, its_base, (x, y))
            is_long = piece.length >= settings.min_length * palm_radius
            if is_long and piece.length >= settings.min_elongation * piece.width:
                pieces.append(piece)
    return sorted(pieces, key=lambda piece: -piece.area)[:_PIECES]


def _branches(
    inside: np.ndarray, contact: np.ndarray, centre: np.ndarray, palm_radius: float
) -> list[tuple[np.ndarray, np.ndarray]]:
    """The piece with its base, or its branches with theirs where it is two fingers that meet at their web.

    Farther from the palm than the web the fingers are apart: the lowest such distance splits them.
    """
    outline, _ = cv2.findContours(inside.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    hull = cv2.contourArea(cv2.convexHull(np.concatenate(outline)))
    if inside.sum() > _SOLID * hull:
        return [(inside, contact)]
    y, x = np.indices(inside.shape)
    distance = np.where(inside, np.hypot(x - centre[0], y - centre[1]), 0.0)
    low, high = float(distance[inside].min()), float(distance.max())
    step = max(1.0, 0.05 * palm_radius)
    levels = np.arange(low, high - _MIN_BRANCH * palm_radius, step)
    for level in levels[_may_split(distance, levels, int(_MIN_BRANCH * palm_radius / step))]:
        pieces = label_pieces(torch.from_numpy(distance > level))
        parts = [pieces.labels.numpy() == label for label in range(1, len(pieces.areas) + 1)]
        parts = [part for part in parts if distance[part].max() > level + _MIN_BRANCH * palm_radius]
        if len(parts) > 1:
            found = []
            for part in parts:
                found += _branches(part, part & (distance < level + 1.5), centre, palm_radius)
            return found
    return [(inside, contact)]


def _may_split(distance: np.ndarray, levels: np.ndarray, lasting: int) -> np.ndarray:
    """Levels beyond which there may be two pieces that both reach `lasting` levels farther.

    Such pieces are apart at all these levels as well, so that looking at every one of so many misses none.
    """
    is_apart = np.zeros(len(levels), bool)
    for first in range(0, len(levels), max(1, lasting)):
        probed = min(first + max(1, lasting) - 1, len(levels) - 1)
        if count_pieces(torch.from_numpy(distance > levels[probed])) > 1:
            is_apart[first : probed + 1] = True
    return is_apart


def _measured(inside: np.ndarray, contact: np.ndarray, corner: tuple[int, int]) -> FingerPiece:
    base = np.argwhere(contact).mean(0)[::-1] + corner
    points = np.argwhere(inside)[:, ::-1] + corner
    distance = np.hypot(*(points - base).T)
    tip = points[distance >= distance.max() - 1.0].mean(0)
    area, length = float(len(points)), max(float(np.hypot(*(tip - base))), 1e-6)
    return FingerPiece(
        tip=(float(tip[0]), float(tip[1])), base=(float(base[0]), float(base[1])), width=area / length, area=area
    )


def _merit(found: FingerSearch) -> float:
    """How many fingers agree with an open hand, then how well, then how long they stand out."""
    if found.order is None:
        return 0.0
    return len(found.order.fingers) - min(0.9, 2.0 * found.order.misfit)


def _in_picture(found: FingerSearch, scale: float, corner: tuple[int, int]) -> FingerSearch:
    """A search's result in px of the whole picture."""

    def moved(point: tuple[float, float]) -> tuple[float, float]:
        x, y = ((coordinate - 1.0 + 0.5) / scale - 0.5 for coordinate in point)
        return x + corner[0], y + corner[1]

    order = found.order
    if order is not None:
        order = replace(order, wrist=moved(order.wrist), hand_length=order.hand_length / scale)
    pieces = tuple(
        FingerPiece(tip=moved(piece.tip), base=moved(piece.base), width=piece.width / scale, area=piece.area / scale**2)
        for piece in found.pieces
    )
    return FingerSearch(
        pieces=pieces,
        order=order,
        disc_radius=found.disc_radius / scale,
        palm_radius=found.palm_radius / scale,
        palm_centre=moved(found.palm_centre),
    )
