"""From counts of colours to log-likelihood ratios, and the look-up of such a table; for skin and colour models."""

import cv2
import numpy as np
import torch

UNIFORM_FOREGROUND, UNIFORM_BACKGROUND = 0.005, 0.02
"""Share of each class spread evenly over all colours: one never seen is background at 4 : 1."""
WIDE_FRACTION = 0.05
"""Share of each count spread widely, so that a mixed colour at an outline falls to the class it resembles."""
WIDE_FACTOR = 4.0
"""How much wider, in widths of the ordinary smoothing."""


def smoothed(counts: np.ndarray, sigma_bins: float, wrapped_axes: tuple[int, ...] = ()) -> np.ndarray:
    """Counts spread by a Gaussian plus a little of one 4 times wider; the sum stays. Wrapped axes are circles."""
    if sigma_bins <= 0:
        return counts
    narrow, wide = counts, counts
    for axis, size in enumerate(counts.shape):
        narrow = _along(_spreading(size, sigma_bins, axis in wrapped_axes), narrow, axis)
        wide = _along(_spreading(size, WIDE_FACTOR * sigma_bins, axis in wrapped_axes), wide, axis)
    return (1.0 - WIDE_FRACTION) * narrow + WIDE_FRACTION * wide


def log_ratio(foreground: np.ndarray, background: np.ndarray) -> np.ndarray:
    """Log of the likelihood ratio per cell from non-negative weights of each cell, each class scaled to one."""
    cells = foreground.size
    fraction_foreground = (1.0 - UNIFORM_FOREGROUND) * foreground / foreground.sum() + UNIFORM_FOREGROUND / cells
    fraction_background = (1.0 - UNIFORM_BACKGROUND) * background / background.sum() + UNIFORM_BACKGROUND / cells
    return np.log(fraction_foreground / fraction_background)


def probability_u8(log_ratios: np.ndarray) -> np.ndarray:
    """Probability of the foreground, equally likely beforehand, times 255, rounded, as float32."""
    return np.rint(255.0 / (1.0 + np.exp(-log_ratios.astype(np.float64)))).astype(np.float32)


def look_up(picture: np.ndarray, table: np.ndarray, ends: tuple[int, ...]) -> np.ndarray:
    """8-bit values of `table` at a picture's first channels, channel k being divided evenly over 0..ends[k]."""
    if len(ends) == 2:
        return _look_up_pairs(picture, table, ends)
    ranges = [bound for end in ends for bound in (0, end)]
    cells = cv2.Mat(table, wrap_channels=False)  # or else a third axis is taken for channels
    return cv2.calcBackProject([picture], list(range(len(ends))), cells, ranges, 1)


def _look_up_pairs(picture: np.ndarray, table: np.ndarray, ends: tuple[int, ...]) -> np.ndarray:
    """`look_up` for two channels: the table, spread over their values, is read as a picture; in half the time."""
    first, second = (np.arange(end) * size // end for size, end in zip(table.shape, ends, strict=True))
    spread = np.ascontiguousarray(table.T.astype(np.uint8)[second].take(first, 1))
    place = np.empty((*picture.shape[:2], 2), np.uint8)
    cv2.mixChannels([picture], [place], [0, 0, 1, 1])
    return cv2.remap(spread, place.astype(np.int16), None, cv2.INTER_NEAREST)  # pyright: ignore[reportCallIssue, reportArgumentType]


def _spreading(size: int, sigma: float, wraps: bool) -> np.ndarray:
    """Matrix (size, size) whose column j spreads a count of bin j; columns sum to one."""
    distance = np.abs(np.arange(size)[:, None] - np.arange(size)[None, :]).astype(np.float64)
    if wraps:
        distance = np.minimum(distance, size - distance)
    weights = np.exp(-0.5 * (distance / sigma) ** 2)
    return weights / weights.sum(axis=0)


def _along(matrix: np.ndarray, counts: np.ndarray, axis: int) -> np.ndarray:
    first = np.ascontiguousarray(np.moveaxis(counts, axis, 0))
    flat = torch.from_numpy(first.reshape(len(first), -1))
    product = torch.from_numpy(matrix) @ flat  # by torch, whose threads the caller chooses
    return np.moveaxis(product.numpy().reshape(first.shape), 0, axis)
