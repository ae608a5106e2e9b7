"""Silhouettes where colours overlap: graph cut about a first guess, and the guesses that one picture offers.

Skin colour alone takes a skin-coloured wall or shirt for the hand. OpenCV's GrabCut puts the outline onto edges between
what is surely inside and surely outside a guess; several guesses by colour and brightness are offered, and the one
whose refined outline has an open hand's fingers and lies on edges is the hand.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Bool, UInt8
from torch import Tensor

from torchhand.image.contours import depth_map, distance_map
from torchhand.image.fingers.fingers import FingerSearch, FingerSettings, find_fingers
from torchhand.image.fingers.order import DIGITS
from torchhand.image.operations import dilate, enlarged_mask, intersection_over_union, square_kernel
from torchhand.image.segmentation import bootstrap_skin, clean, fill_holes, largest_component, skin_candidates

_MIN_AREA_FRACTION, _MAX_AREA_FRACTION = 0.02, 0.75  # of the picture that a hand may cover
_MAX_BORDER = 0.75  # of the picture's border that a hand may take up: more is what is behind it
_FAIR_FINGERS = 3  # a guess that shows fewer is not refined
_REFINED = 3  # guesses refined
_WORKERS = 4  # threads that look at guesses
_SAME = 0.97  # intersection over union of guesses of which one is refined for both
_QUICK_SIDE_PX = 480  # longer side of the pictures in which fingers are only counted
_QUICK = FingerSettings(sizes=8, work_side_px=200)
_LUMA_RANGE = (0.55, 1.6)  # of a digit over the palm beside it: shadows are darker
_MAX_CHROMA = 14.0  # distance of a digit's mean (Cr, Cb) from that of the palm's middle, 8-bit levels
_OPEN_MISFIT = 0.09
"""Misfit of an open hand's digits: the worst of 15 photographs of open hands has 0.089, the best of eight of other
signs in which five digits seem to stand out 0.094."""
_INTO_PALM = 0.35  # of the way from a digit's base to the palm's centre: the palm beside it
_MIN_GRADIENT = 0.03  # change of a channel (0..1) across the outline that counts as an edge


@dataclass(frozen=True, kw_only=True)
class RefinementSettings:
    """How the graph cut is set up."""

    max_side_px: int = 320
    """Larger pictures are reduced to this longer side for the cut; >= 32."""
    core_fraction: float = 0.35
    """Fraction of a guess's greatest depth beyond which a pixel is surely inside; between 0 and 1."""
    band_fraction: float = 0.5
    """Distance from a guess, as a fraction of its greatest depth, beyond which a pixel is surely outside; above 0."""
    iterations: int = 3
    """Rounds of the cut; 1 or more."""

    def __post_init__(self) -> None:
        if self.max_side_px < 32:
            raise ValueError(f"RefinementSettings.max_side_px must be >= 32, got {self.max_side_px}")
        if not 0 < self.core_fraction < 1:
            raise ValueError(f"RefinementSettings.core_fraction must lie between 0 and 1, got {self.core_fraction}")
        if not 0 < self.band_fraction < float("inf"):
            raise ValueError(f"RefinementSettings.band_fraction must be > 0, got {self.band_fraction}")
        if self.iterations < 1:
            raise ValueError(f"RefinementSettings.iterations must be >= 1, got {self.iterations}")


@dataclass(frozen=True, kw_only=True)
class HandSilhouette:
    """The best silhouette of an open hand that a picture offers."""

    mask: Bool[Tensor, "height width"]
    """Largest piece, holes filled; False everywhere where nothing is hand-like."""
    source: str
    """How it was found: the guess, and whether it was refined."""
    search: FingerSearch | None
    """Search for the silhouette's fingers."""
    edge_fraction: float
    """Share of its outline, the picture's border left out, that lies on edges of the picture."""
    odd_digits: tuple[str, ...] = ()
    """Digits of another colour than the palm's: shadows, or something behind the hand."""


def refine_silhouette(
    image: UInt8[Tensor, "height width 3"],
    guess: Bool[Tensor, "height width"],
    settings: RefinementSettings | None = None,
) -> Bool[Tensor, "height width"]:
    """The guess with its outline put onto the picture's edges by a graph cut between learned colours (GrabCut).

    The core of the guess stays inside and what is far from it outside. An empty or full guess comes back as it is.
    """
    settings = settings or RefinementSettings()
    height, width = guess.shape
    size = _size_within(height, width, settings.max_side_px)
    small = cv2.resize(guess.cpu().numpy().astype(np.uint8) * 255, size, interpolation=cv2.INTER_AREA) > 127
    if not small.any() or small.all():
        return guess
    pixels = cv2.resize(image.cpu().contiguous().numpy(), size, interpolation=cv2.INTER_AREA)
    cut = _cut(np.ascontiguousarray(pixels[..., ::-1]), small, settings)
    if cut is None:
        return guess
    return enlarged_mask(torch.from_numpy(cut), height, width).to(guess.device)


def find_open_hand(
    image: UInt8[Tensor, "height width 3"], settings: RefinementSettings | None = None
) -> HandSilhouette:
    """The silhouette of an open hand, from colour, shape and edges of one picture.

    Guesses are what skin looks like in this picture (`bootstrap_skin`) and Otsu's halves of several channels. The most
    hand-like of them are refined, and of all the one with most fingers in an open hand's order, on edges, is taken.
    Where that lacks a finger, or has one of another colour, an open hand among the pieces that may be skin is taken
    (`skin_candidates`).
    """
    settings = settings or RefinementSettings()
    edges = _edges(image)
    found = _best_of(image, edges, _guesses(image, settings.max_side_px), settings)
    if found is None or not _is_whole(found):  # such as before a wall of skin's colour, or in a hard shadow
        other = _best_of(image, edges, _skin_guesses(image, settings.max_side_px), settings)
        found = other if other is not None and _is_surely_open(other) else found
    if found is None:
        nothing = torch.zeros(image.shape[:2], dtype=torch.bool, device=image.device)
        return HandSilhouette(mask=nothing, source="none", search=None, edge_fraction=0.0)
    return found


def fingers_apart(image: UInt8[Tensor, "height width 3"]) -> int | None:
    """How many fingers stand out of what looks like skin in a picture; all five only where that surely is an open hand,
    by how they lie. None where nothing is as large as a hand.

    Quick; where a hand is not told by the colour of skin alone, `find_open_hand` finds many more.
    """
    size = _size_within(image.shape[0], image.shape[1], _QUICK_SIDE_PX)
    small = torch.from_numpy(cv2.resize(image.cpu().contiguous().numpy(), size, interpolation=cv2.INTER_AREA))
    skin = bootstrap_skin(small).mask
    found = _judged(small, _edges(small), skin, "skin") if bool(skin.any()) else None
    if found is None:
        return None
    return len(DIGITS) if _is_surely_open(found) else min(_fingers(found), len(DIGITS) - 1)


def _size_within(height: int, width: int, max_side_px: int) -> tuple[int, int]:
    """Width and height of a picture that is reduced to a longer side, as OpenCV takes them."""
    scale = min(1.0, max_side_px / max(height, width))
    return max(1, round(width * scale)), max(1, round(height * scale))


def _best_of(
    image: Tensor, edges: np.ndarray, guesses: Sequence[tuple[str, Tensor]], settings: RefinementSettings
) -> HandSilhouette | None:
    """The most hand-like of some guesses, by names, and of those that are refined."""

    def refined(guess: HandSilhouette) -> HandSilhouette | None:
        return _judged(image, edges, refine_silhouette(image, guess.mask, settings), f"{guess.source}, graph cut")

    with ThreadPoolExecutor(_WORKERS) as workers:  # nearly all the time is OpenCV's and NumPy's, which lets others run
        judged = workers.map(lambda guess: _judged(image, edges, guess[1], guess[0]), guesses)
        found = sorted((guess for guess in judged if guess is not None), key=_merit, reverse=True)
        tried: list[HandSilhouette] = []
        for guess in found[:_REFINED]:
            if _fingers(guess) >= _FAIR_FINGERS and not any(_alike(guess.mask, other.mask) for other in tried):
                tried.append(guess)
        cuts = [cut for cut in workers.map(refined, tried) if cut is not None]
    return max(found + cuts, key=_merit, default=None)


def edge_fraction(image: UInt8[Tensor, "height width 3"], mask: Bool[Tensor, "height width"]) -> float:
    """Share of a silhouette's outline that lies on edges of the picture; the picture's border counts for neither."""
    return _fraction_on(_edges(image), mask)


def _fraction_on(edges: np.ndarray, mask: Tensor) -> float:
    height, width = mask.shape
    outlines, _ = cv2.findContours(mask.cpu().numpy().astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not outlines:
        return 0.0
    points = np.concatenate([np.asarray(outline, np.int64)[:, 0] for outline in outlines])
    inner = (points[:, 0] > 2) & (points[:, 1] > 2) & (points[:, 0] < width - 3) & (points[:, 1] < height - 3)
    points = points[inner]
    if not len(points):
        return 0.0
    return float((edges[points[:, 1], points[:, 0]] > _MIN_GRADIENT).mean())


def _edges(image: Tensor) -> np.ndarray:
    """Steepest change of any channel within 2 px of each pixel, shares of white per px."""
    soft = cv2.GaussianBlur(image.cpu().contiguous().numpy(), (0, 0), 1.0).astype(np.float32) / 255.0
    strength = np.zeros(soft.shape[:2], np.float32)
    for channel in cv2.split(soft):
        gradient = cv2.magnitude(cv2.Sobel(channel, cv2.CV_32F, 1, 0), cv2.Sobel(channel, cv2.CV_32F, 0, 1)) / 8.0
        strength = np.maximum(strength, gradient)
    return dilate(torch.from_numpy(strength), square_kernel(2)).numpy()


def _cut(pixels: np.ndarray, guess: np.ndarray, settings: RefinementSettings) -> np.ndarray | None:
    inside = torch.from_numpy(guess)
    depth, away = depth_map(inside).numpy(), distance_map(inside).numpy()
    greatest = float(depth.max())
    marks = np.where(guess, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    marks[depth > settings.core_fraction * greatest] = cv2.GC_FGD
    marks[away > settings.band_fraction * greatest] = cv2.GC_BGD
    if not ((marks == cv2.GC_BGD) | (marks == cv2.GC_PR_BGD)).any():
        return None
    models = np.zeros((1, 65)), np.zeros((1, 65))
    cv2.setRNGSeed(0)
    try:
        cv2.grabCut(pixels, marks, (0, 0, 0, 0), *models, settings.iterations, cv2.GC_INIT_WITH_MASK)
    except cv2.error:
        return None  # too few pixels for its mixtures
    return (marks == cv2.GC_FGD) | (marks == cv2.GC_PR_FGD)


def _guesses(image: Tensor, max_side_px: int) -> list[tuple[str, Tensor]]:
    """Names and masks: learned skin, and both halves of Otsu's splits of channels."""
    start = bootstrap_skin(image)
    found = [("skin", start.mask)] if bool(start.mask.any()) else []
    pixels = cv2.GaussianBlur(image.cpu().contiguous().numpy(), (0, 0), max(1.0, max(image.shape[:2]) / 400))
    luma, cr, cb = cv2.split(cv2.cvtColor(pixels, cv2.COLOR_RGB2YCrCb))
    saturation = cv2.extractChannel(cv2.cvtColor(pixels, cv2.COLOR_RGB2HSV), 1)
    for name, plane in (("redness", cr), ("blueness", cb), ("brightness", luma), ("saturation", saturation)):
        _, split = cv2.threshold(plane, 0, 1, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
        for sign, half in (("more", split > 0), ("less", split == 0)):
            found.append((f"{sign} {name}", torch.from_numpy(half)))
    return found


def _skin_guesses(image: Tensor, max_side_px: int) -> list[tuple[str, Tensor]]:
    """Names and masks: pieces that may be hand and bare forearm, most of them cut along edges."""
    height, width = image.shape[:2]
    pieces = skin_candidates(image, max_side_px=max_side_px)
    return [("piece of skin", enlarged_mask(piece, height, width)) for piece in pieces]


def _judged(image: Tensor, edges: np.ndarray, mask: Tensor, source: str) -> HandSilhouette | None:
    piece = largest_component(clean(mask.cpu()))
    piece = fill_holes(piece, max_area=max(1, piece.numel() // 500))
    fraction = float(piece.double().mean())
    border = torch.cat((piece[0], piece[-1], piece[:, 0], piece[:, -1])).double().mean()
    if not _MIN_AREA_FRACTION < fraction < _MAX_AREA_FRACTION or float(border) > _MAX_BORDER:
        return None
    search = find_fingers(piece, _QUICK)
    return HandSilhouette(
        mask=piece.to(image.device),
        source=source,
        search=search,
        edge_fraction=_fraction_on(edges, piece),
        odd_digits=odd_digits(image, search),
    )


def odd_digits(image: UInt8[Tensor, "height width 3"], search: FingerSearch) -> tuple[str, ...]:
    """Digits whose colour along their axis is not the palm's: its hue in the middle of the palm, or its brightness
    beside the digit, for the light on a palm varies."""
    if search.order is None:
        return ()
    pixels = cv2.cvtColor(image.cpu().contiguous().numpy(), cv2.COLOR_RGB2YCrCb).astype(np.float32)
    palm = _mean_along(pixels, search.palm_centre, search.palm_centre, 0.6 * search.palm_radius)
    odd = []
    for name, number in search.order.fingers.items():
        piece = search.pieces[number]
        digit = _mean_along(pixels, piece.base, piece.tip, 0.25 * piece.width)
        (x, y), (to_x, to_y) = piece.base, search.palm_centre
        inward = (x + _INTO_PALM * (to_x - x), y + _INTO_PALM * (to_y - y))
        beside = _mean_along(pixels, piece.base, inward, 0.25 * piece.width)
        is_lit = _LUMA_RANGE[0] < digit[0] / max(float(beside[0]), 1.0) < _LUMA_RANGE[1]
        if not is_lit or float(np.hypot(*(digit - palm)[1:])) > _MAX_CHROMA:
            odd.append(name)
    return tuple(odd)


def _mean_along(pixels: np.ndarray, start: tuple[float, float], end: tuple[float, float], radius: float) -> np.ndarray:
    """Mean colour within a radius of a stretch."""
    mask = np.zeros(pixels.shape[:2], np.uint8)
    ends = [(round(x), round(y)) for x, y in (start, end)]
    cv2.line(mask, ends[0], ends[1], 1, max(1, round(2 * radius)))
    return np.array(cv2.mean(pixels, mask)[:3])


def _alike(first: Tensor, second: Tensor) -> bool:
    """Whether a cut about one mask would end where one about the other does."""
    return float(intersection_over_union(first, second)) >= _SAME


def _is_whole(found: HandSilhouette) -> bool:
    """Whether all five digits stand out, in the palm's colour."""
    return _fingers(found) == len(DIGITS) and not found.odd_digits


def _is_surely_open(found: HandSilhouette) -> bool:
    """Whether its digits lie as those of open hands do, and as digits that stand out of other postures do not."""
    order = None if found.search is None else found.search.order
    return _is_whole(found) and order is not None and order.misfit < _OPEN_MISFIT


def _fingers(found: HandSilhouette) -> int:
    return 0 if found.search is None or found.search.order is None else len(found.search.order.fingers)


def _merit(found: HandSilhouette) -> float:
    """Fingers in an open hand's order first; then how well they lie, and how much of the outline lies on edges."""
    order = None if found.search is None else found.search.order
    if order is None:
        return found.edge_fraction
    return len(order.fingers) - len(found.odd_digits) + 2.0 * found.edge_fraction - 10.0 * order.misfit
