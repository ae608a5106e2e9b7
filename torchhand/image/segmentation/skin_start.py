"""The first skin model of a video, from one picture and a broad notion of human skin."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Bool, UInt8
from torch import Tensor

from torchhand.image.operations import dilate, erode, square_kernel
from torchhand.image.segmentation.components import clean, fill_holes, largest_component
from torchhand.image.segmentation.skin import SkinModel, learn_skin, skin_probability

SKIN_CHROMA = (149.0, 111.0)
"""Middle of human skin in (Cr, Cb), 8 bit: pale and dark people differ in brightness far more than here."""
SKIN_CHROMA_SPREAD = (10.0, 9.0)
"""Standard deviations around it over people and lamps."""
SKIN_CHROMA_RANGE = ((132.0, 182.0), (74.0, 126.0))
"""Beyond these no skin is believed: (least, greatest) of Cr, of Cb."""
MIN_CONTRAST = 6.0
"""Least distance of the mean (Cr, Cb) of skin and rest, 8-bit levels: halves of a wall differ by 2 to 4, skin by 12."""
MIN_AREA_FRACTION, MAX_AREA_FRACTION = 0.004, 0.8
MAX_BORDER_FRACTION = 0.6

_UNKNOWN = SkinModel(log_ratio=torch.full((1, 1), -1.0), dark_log_ratio=-1.0, dark_value=0)


@dataclass(frozen=True, kw_only=True)
class CrSplit:
    """Otsu's split of a picture by Cr (YCrCb)."""

    mask: Bool[Tensor, "height width"]
    """The redder class."""
    threshold: float
    """Greatest Cr of the other class."""
    contrast: float
    """Mean Cr of the redder class minus that of the other, in 8-bit levels; 0 when the picture has one Cr only."""


@dataclass(frozen=True, kw_only=True)
class SkinStart:
    """A skin model learned from one picture, with what tells a hand from a bare wall."""

    model: SkinModel
    mask: Bool[Tensor, "height width"]
    """Largest piece of skin, holes filled; False everywhere when `has_skin` is False."""
    has_skin: bool
    """Whether the piece passes: colour inside `SKIN_CHROMA_RANGE`, distinct from the rest, of a believable size."""
    reason: str
    """Why not; empty when `has_skin`."""
    separability: float
    """Distance of the mean (Cr, Cb) of skin and of the rest over the sum of their root mean square spreads."""
    contrast: float
    """Distance of the means of both parts in 8-bit levels."""
    chroma: tuple[float, float]
    """Mean (Cr, Cb) of the piece."""
    area_fraction: float
    """Pixels of the piece over all."""
    border_fraction: float
    """Share of the picture's outermost pixels that belong to the piece: large for a wall or a table."""


GREY = (
    "the picture is grey: without colours a hand is not told from its surroundings unless keypoints or a silhouette are"
    " given"
)
"""Said of pictures that have no colour."""
_NO_COLOUR = 128.0  # of Cr and Cb
_MAX_CHROMA, _COLOURLESS = 4.0, 0.995  # levels that chroma differs from none in that share of a grey picture at most


def otsu_cr_mask(image: UInt8[Tensor, "height width 3"]) -> CrSplit:
    """Redder half of a picture by Otsu's threshold on Cr. It always splits: look at `contrast`."""
    cr = _chroma(image)[..., 0]
    threshold, redder = cv2.threshold(cr, 0, 1, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    mask = redder.astype(bool)
    contrast = float(cr[mask].mean() - cr[~mask].mean()) if mask.any() and not mask.all() else 0.0
    return CrSplit(mask=torch.from_numpy(mask).to(image.device), threshold=float(threshold), contrast=contrast)


def bootstrap_skin(image: UInt8[Tensor, "height width 3"], *, max_side_px: int = 320, rounds: int = 2) -> SkinStart:
    """Learn skin from one picture in which a hand may be, with nothing known but what human skin is like at large.

    Worked out on the picture reduced to `max_side_px`. Proposals are Otsu's redder half, and the neighbourhoods of the
    most frequent colours after weighing by a broad Gaussian of human skin in (Cr, Cb), each neighbourhood ending where
    Otsu splits the distances to its colour. Each proposal's largest piece teaches a histogram, which segments anew,
    `rounds` times. The best of them is the one that is most distinct, most skin-like and least along the border.
    When none passes, `has_skin` is False and `reason` says why: a bare wall, which Otsu also splits, ends there.
    """
    height, width = image.shape[:2]
    scale = min(1.0, max_side_px / max(height, width))
    pixels = image.cpu().contiguous().numpy()
    if scale < 1.0:
        size = (max(1, round(width * scale)), max(1, round(height * scale)))
        pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    small = torch.from_numpy(pixels)
    starts = [_grow(small, proposal, rounds) for proposal in skin_proposals(small)]
    best = max(starts, key=_merit)
    mask = torch.zeros(height, width, dtype=torch.bool)
    if best.has_skin:
        skin = skin_probability(image.cpu(), best.model) > 0.5
        mask = fill_holes(largest_component(clean(skin)), max_area=max(1, skin.numel() // 500))
    elif is_grey(small):
        best = replace(best, reason=GREY)
    return replace(best, mask=mask.to(image.device))


def is_grey(image: UInt8[Tensor, "height width 3"]) -> bool:
    """Whether a picture has no colour but for what compression leaves of noise: skin cannot be told in it."""
    chroma = _chroma(image).astype(np.float64) - _NO_COLOUR
    return bool(np.quantile(np.abs(chroma).max(-1), _COLOURLESS) <= _MAX_CHROMA)


def skin_proposals(image: UInt8[Tensor, "height width 3"]) -> list[Bool[Tensor, "height width"]]:
    """Otsu's redder half, and the neighbourhoods of the colours that are most frequent and most like skin."""
    chroma = cv2.GaussianBlur(_chroma(image), (3, 3), 0)
    proposals = [otsu_cr_mask(image).mask & torch.from_numpy(_is_believable(chroma))]
    bright = (image.amax(dim=-1) >= 24).to(torch.uint8).numpy()
    histogram = cv2.calcHist([chroma], [0, 1], bright, [256, 256], [0, 256, 0, 256])
    histogram = cv2.GaussianBlur(histogram, (0, 0), 2.5)
    cr, cb = np.meshgrid(np.arange(256.0), np.arange(256.0), indexing="ij")
    weighed = histogram * skin_likeness(cr, cb)
    for _ in range(3):
        peak = np.unravel_index(int(weighed.argmax()), weighed.shape)
        if weighed[peak] <= 0.0:
            break
        distance = np.hypot(chroma[..., 0] - float(peak[0]), chroma[..., 1] - float(peak[1]))
        eighths = np.minimum(8.0 * distance, 255.0).astype(np.uint8)
        _, far = cv2.threshold(eighths, 0, 1, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
        proposals.append(torch.from_numpy(far == 0))
        weighed[np.hypot(cr - peak[0], cb - peak[1]) < 9.0] = 0.0
    return proposals


def _grow(image: Tensor, proposal: Tensor, rounds: int) -> SkinStart:
    """Largest piece -> histogram -> segmentation -> largest piece, and its measures."""
    piece = largest_component(clean(proposal))
    model = _UNKNOWN
    for _ in range(rounds):
        if not bool(piece.any()) or bool(piece.all()):
            break
        model = learn_skin(image, piece, _rim(piece))
        piece = largest_component(clean(skin_probability(image, model) > 0.5))
    return _measured(image, piece, model)


def _rim(piece: Tensor) -> Tensor:
    """Pixels within 1 px of the outline, whose colour is mixed; none where the piece is too thin to do without them."""
    core, grown = erode(piece, square_kernel(1)), dilate(piece, square_kernel(1))
    if int(core.sum()) < 0.25 * int(piece.sum()) or bool(grown.all()):
        return torch.zeros_like(piece)
    return grown & ~core


def _measured(image: Tensor, piece: Tensor, model: SkinModel) -> SkinStart:
    inside = piece.numpy()
    area = float(inside.mean())
    border = np.concatenate([inside[0], inside[-1], inside[1:-1, 0], inside[1:-1, -1]])
    skin, contrast, separability = np.full((2, 1), np.nan), 0.0, 0.0
    if 0.0 < area < 1.0:
        chroma = _chroma(image)
        (skin, skin_std), (rest, rest_std) = (
            cv2.meanStdDev(chroma, mask=mask.astype(np.uint8)) for mask in (inside, ~inside)
        )
        contrast = float(np.hypot(*(skin - rest)[:, 0]))
        spread = np.linalg.norm(skin_std) + np.linalg.norm(rest_std)
        separability = contrast / max(float(spread), 1e-6)
    start = SkinStart(
        model=model,
        mask=piece,
        has_skin=False,
        reason="",
        separability=separability,
        contrast=contrast,
        chroma=(float(skin[0, 0]), float(skin[1, 0])),
        area_fraction=area,
        border_fraction=float(border.mean()),
    )
    reason = _objection(start)
    return replace(start, has_skin=not reason, reason=reason)


def _objection(start: SkinStart) -> str:
    if not MIN_AREA_FRACTION <= start.area_fraction <= MAX_AREA_FRACTION:
        return f"the skin-coloured piece covers {100 * start.area_fraction:.1f} % of the picture"
    if skin_likeness(*start.chroma) == 0.0:
        return f"its colour (Cr {start.chroma[0]:.0f}, Cb {start.chroma[1]:.0f}) is not one of human skin"
    if start.contrast < MIN_CONTRAST:
        return f"its colour differs from the rest by {start.contrast:.1f} levels only"
    if start.border_fraction > MAX_BORDER_FRACTION:
        return f"it fills {100 * start.border_fraction:.0f} % of the picture's border, as a background does"
    return ""


def _merit(start: SkinStart) -> float:
    likeness = float(skin_likeness(*start.chroma))
    return float(start.has_skin) + likeness * min(start.separability, 3.0) * (1.0 - start.border_fraction) ** 3


def skin_likeness(cr: np.ndarray | float, cb: np.ndarray | float) -> np.ndarray:
    """Broad Gaussian of human skin, 1 in its middle, 0 beyond the believable range."""
    square = ((np.asarray(cr) - SKIN_CHROMA[0]) / SKIN_CHROMA_SPREAD[0]) ** 2
    square = square + ((np.asarray(cb) - SKIN_CHROMA[1]) / SKIN_CHROMA_SPREAD[1]) ** 2
    return np.asarray(np.exp(-0.5 * square) * _is_believable(np.stack(np.broadcast_arrays(cr, cb), axis=-1)))


def mean_skin_likeness(image: UInt8[Tensor, "height width 3"], mask: Bool[Tensor, "height width"]) -> float:
    """Mean likeness to human skin, 0 to 1, of the pixels of a mask; 0 for an empty one."""
    inside = _chroma(image)[mask.cpu().numpy()].astype(np.float64)
    return float(skin_likeness(inside[:, 0], inside[:, 1]).mean()) if len(inside) else 0.0


def _is_believable(chroma: np.ndarray) -> np.ndarray:
    (low_cr, high_cr), (low_cb, high_cb) = SKIN_CHROMA_RANGE
    cr, cb = chroma[..., 0], chroma[..., 1]
    return np.asarray((cr >= low_cr) & (cr <= high_cr) & (cb >= low_cb) & (cb <= high_cb))


def _chroma(image: Tensor) -> np.ndarray:
    """(Cr, Cb) per pixel, 8 bit."""
    return np.ascontiguousarray(cv2.cvtColor(image.cpu().contiguous().numpy(), cv2.COLOR_RGB2YCrCb)[..., 1:])
