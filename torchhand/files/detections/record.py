"""Hand keypoints that a detector found, whatever file they come from."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float64, Int

from torchhand.errors import InputError

Side = Literal["left", "right"]
Units = Literal["metres", "px", "normalised"]
COUNT = 21


@dataclass(frozen=True, kw_only=True)
class Detections:
    """One hand's keypoints, frame by frame."""

    keypoints: Float64[np.ndarray, "frames 21 d"]
    """In the project's order (wrist, thumb, index, middle, ring, little; MediaPipe's and OpenPose's); NaN where
    missing. d is 3 for metres, 2 for pictures."""
    confidence: Float64[np.ndarray, "frames 21"]
    """0 where missing, 1 where the detector gives none."""
    frame: Int[np.ndarray, "frames"]
    """Number of each frame in its sequence."""
    side: Side | None
    """Which hand, where the file tells."""
    units: Units
    """metres (in the detector's own frame), px, or shares of the picture's width and height."""
    size: tuple[int, int] | None = None
    """Width and height of the pictures, px, where the file tells."""

    def __len__(self) -> int:
        return len(self.frame)

    def in_pixels(self, width: int, height: int) -> "Detections":
        """Shares of the picture as px: 0 and 1 are the picture's edges, the centre of the first pixel is (0, 0)."""
        if self.units == "metres":
            raise ValueError("units: expected points of a picture, got metres")
        if self.units == "px":
            return self
        points = self.keypoints * np.array((width, height), dtype=np.float64) - 0.5
        return replace(self, keypoints=points, units="px", size=(width, height))


def detections_of(
    where: str,
    rows: list[tuple[int, np.ndarray | None, np.ndarray | None]],
    *,
    side: Side | None,
    units: Units,
    size: tuple[int, int] | None = None,
) -> Detections:
    """The record of frames (number, points, confidences); a frame without a hand has None.

    Raises InputError where no frame has a hand.
    """
    dimension = 3 if units == "metres" else 2
    keypoints = np.full((len(rows), COUNT, dimension), np.nan)
    confidence = np.zeros((len(rows), COUNT))
    for i, (_, found, trust) in enumerate(rows):
        if found is not None:
            keypoints[i] = found[:, :dimension]
            confidence[i] = 1.0 if trust is None else trust
    is_missing = ~np.isfinite(keypoints).all(-1) | ~np.isfinite(confidence) | (confidence <= 0)
    if is_missing.all():
        of_side = "" if side is None else f" {side}"
        raise InputError(f"{where}: expected at least one{of_side} hand, got none in {len(rows)} frames")
    keypoints[is_missing], confidence[is_missing] = np.nan, 0.0
    return Detections(
        keypoints=keypoints,
        confidence=confidence,
        frame=np.array([number for number, _, _ in rows], dtype=np.int64),
        side=side,
        units=units,
        size=size,
    )
