"""Where the silhouette of an arm ends: its hand is there, and not where it leaves the picture."""

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.image import reduced_mask

END_REACH = 1.25
"""Hand lengths from the farthest place of a silhouette that may be the hand's."""
_ARM_LENGTH, _END_LENGTH = 2.0, 1.6
"""Hand lengths from which on a silhouette is a long arm's, and those of its end that may be the hand: with as much of
the forearm as pictures of hands show."""
_SIDE_PX = 240  # longer side of the reduced silhouettes
_KERNELS = tuple(cv2.getStructuringElement(kind, (3, 3)) for kind in (cv2.MORPH_CROSS, cv2.MORPH_RECT))


def is_on_arm(
    picture: Bool[Tensor, "height width"],
    model: Bool[Tensor, "height width"],
    palm_px: Float[Tensor, "2"],
    length_px: float,
) -> bool:
    """Whether a model that is cut by the border of a picture lies on an arm whose hand is elsewhere.

    So it is where the silhouette leaves the picture in one place alone, which is where the model is, and ends inside it
    farther away than a hand is long. Where it leaves in several, the hand may be in any of them.

    picture: silhouette of hand and arm. palm_px: the middle of the model's palm. length_px: the hand's length.
    """
    rim = _rim(picture)
    if not bool((_rim(model) & rim).any()) or _pieces(rim) != 1:
        return False
    lengths = lengths_to_end(picture)
    if lengths is None:
        return False
    scale = lengths.shape[1] / picture.shape[1]
    x, y = (scale * palm_px.cpu()).round().long().tolist()
    length = lengths[min(max(y, 0), lengths.shape[0] - 1), min(max(x, 0), lengths.shape[1] - 1)]
    return float(length) > END_REACH * scale * length_px


def _rim(mask: Bool[Tensor, "height width"]) -> Bool[Tensor, "rim"]:
    """The pixels along a picture's border, clockwise."""
    return torch.cat((mask[0], mask[1:, -1], mask[-1, :-1].flip(0), mask[1:-1, 0].flip(0)))


def _pieces(ring: Bool[Tensor, "rim"]) -> int:
    """Number of pieces that are set in a closed ring."""
    return int((ring & ~ring.roll(1)).sum()) or int(ring.any())


def lengths_to_end(mask: Bool[Tensor, "height width"]) -> Float[Tensor, "h w"] | None:
    """Length in reduced pixels from each pixel of a silhouette to the one farthest from the picture's border, measured
    through the silhouette from the border on; outside, that of the nearest pixel inside. None where the silhouette does
    not touch the border."""
    filled, begin, _ = _small(mask)
    if not begin.any():
        return None
    lengths = _lengths_from(begin, filled)
    lengths = np.where(lengths >= 0, lengths.max() - lengths, 0.0).astype(np.float32)
    _, labels = cv2.distanceTransformWithLabels(1 - filled, cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL)
    label = np.asarray(labels, np.int64)
    of_label = np.zeros(int(label.max()) + 1, np.float32)
    of_label[label[filled > 0]] = lengths[filled > 0]
    return torch.from_numpy(of_label[label])


def _small(mask: Bool[Tensor, "height width"]) -> tuple[np.ndarray, np.ndarray, float]:
    """A silhouette in a reduced picture, those of its pixels that lie along the border, and the scale."""
    height, width = mask.shape
    scale = min(1.0, _SIDE_PX / max(height, width))
    small = reduced_mask(mask.cpu(), max(1, round(scale * height)), max(1, round(scale * width)))
    filled = small.numpy().astype(np.uint8)
    rim = filled.copy()
    rim[1:-1, 1:-1] = 0
    return filled, rim, scale


def _lengths_from(begin: np.ndarray, filled: np.ndarray) -> np.ndarray:
    """Length through a silhouette (height, width) from some of its pixels to each, px; -1 where none leads."""
    lengths, reached, step = np.where(begin > 0, 0.0, -1.0).astype(np.float32), begin, 0
    while True:
        step += 1
        grown = cv2.bitwise_and(cv2.dilate(reached, _KERNELS[step % 2]), filled)
        is_new = grown > reached
        if not is_new.any():
            return lengths
        lengths[is_new] = step
        reached = grown


def hand_end(mask: Bool[Tensor, "height width"], length_px: float) -> Bool[Tensor, "height width"]:
    """The part of a silhouette that may be a hand of some length: of a long arm the end that is farthest from where it
    comes from, which is where it leaves the picture, or else the end nearer to the border; the whole silhouette where
    it is not so long."""
    filled, begin, scale = _small(mask)
    if not filled.any():
        return mask
    if not begin.any():
        first = _farthest(_one_of(filled), filled)
        begin = min(first, _farthest(first, filled), key=_to_border)
    if float(_lengths_from(begin, filled).max()) < _ARM_LENGTH * scale * length_px:
        return mask
    end = _lengths_from(_farthest(begin, filled), filled)
    part = ((end >= 0) & (end <= _END_LENGTH * scale * length_px)).astype(np.uint8)
    large = cv2.resize(part, (mask.shape[1], mask.shape[0]), interpolation=cv2.INTER_NEAREST)
    return mask & torch.from_numpy(large > 0).to(mask.device)


def _to_border(pixel: np.ndarray) -> int:
    """How far the one pixel of a picture lies from its border."""
    height, width = pixel.shape
    y, x = divmod(int(pixel.argmax()), width)
    return min(x, y, width - 1 - x, height - 1 - y)


def _one_of(filled: np.ndarray) -> np.ndarray:
    """One pixel of a silhouette, as a picture."""
    found = np.zeros_like(filled)
    found.flat[int(filled.argmax())] = 1
    return found


def _farthest(begin: np.ndarray, filled: np.ndarray) -> np.ndarray:
    """The pixel farthest from some others through a silhouette, as a picture."""
    found = np.zeros_like(filled)
    found.flat[int(_lengths_from(begin, filled).argmax())] = 1
    return found
