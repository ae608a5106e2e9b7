"""Hand keypoints that a detector found, whatever file they come from."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Float, Float64, Int

from torchhand.errors import InputError

Side = Literal["left", "right"]
Units = Literal["metres", "px", "normalised"]
COUNT = 21


@dataclass(frozen=True, kw_only=True)
class HandDetection:
    """What a detector found in one frame."""

    picture: Float[np.ndarray, "21 _"] | None
    """Points in the picture; NaN where missing, None where the file has none. Columns after the second do not count."""
    space: Float[np.ndarray, "21 3"] | None
    """Points in space, metres in the detector's own coordinates; NaN where missing, None where the file has none."""
    confidence: Float[np.ndarray, "21"] | None
    """Confidence of every point, 0 to 1; None where the detector gives none."""
    label: Side | None = None
    """Side of the hand according to the detector, where the file tells."""
    score: float = float("nan")
    """How sure the detector is of this hand, 0 to 1; NaN where the file does not tell."""


@dataclass(frozen=True, kw_only=True)
class Detections:
    """One hand's keypoints, frame by frame: in the pictures, in space, or both.

    In the project's order: wrist, thumb, index, middle, ring, little, which is that of MediaPipe and OpenPose.
    """

    picture: Float64[np.ndarray, "frames 21 2"] | None
    """Points in the pictures, px, or fractions of the picture's width and height (`is_normalised`); NaN where missing,
    None where the file has none."""
    space: Float64[np.ndarray, "frames 21 3"] | None
    """Points in space, metres in the detector's own coordinates; NaN where missing, None where the file has none."""
    confidence: Float64[np.ndarray, "frames 21"]
    """Confidence of every point, 0 where it is missing, 1 where the detector gives none."""
    frame: Int[np.ndarray, "frames"]
    """Number of each frame in its sequence."""
    label: tuple[Side | None, ...]
    """Side of the hand that the detector saw in each frame, where the file tells; points of other hands are missing."""
    score: Float64[np.ndarray, "frames"]
    """How sure the detector was of the hand in each frame, 0 to 1; NaN where the file does not tell."""
    side: Side | None
    """Side of the hand, where the file tells."""
    is_normalised: bool = False
    image: tuple[str, ...] | None = None
    """Name of each frame's picture, where the file tells."""
    cov_px: Float64[np.ndarray, "frames 21 2 2"] | None = None
    """Covariance of every point in the pictures, px²; NaN where the file does not tell, None where it tells none."""
    size: tuple[int, int] | None = None
    """Width and height of the pictures, px, where the file tells."""

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def units(self) -> Units:
        """Unit of `keypoints`."""
        return "metres" if self.space is not None else "normalised" if self.is_normalised else "px"

    @property
    def keypoints(self) -> Float64[np.ndarray, "frames 21 d"]:
        """Points in space where there are some, else those in the pictures."""
        found = self.picture if self.space is None else self.space
        assert found is not None
        return found

    def in_space(self) -> "Detections":
        """The detections without what is known of the pictures. Raises ValueError where the points are those of
        pictures alone."""
        if self.space is None:
            raise ValueError("units: expected points in space, got those of a picture")
        return replace(self, picture=None, is_normalised=False)

    def in_pixels(self, width: int, height: int) -> "Detections":
        """The points in the pictures alone, as px: of fractions, 0 and 1 are the picture's edges; the first pixel's
        centre is (0, 0). Raises ValueError where there are none."""
        if self.picture is None:
            raise ValueError("units: expected points of a picture, got metres")
        if not self.is_normalised:
            return replace(self, space=None)
        points = self.picture * np.array((width, height), dtype=np.float64) - 0.5
        return replace(self, picture=points, space=None, is_normalised=False, size=(width, height))

    def of_frames(self, numbers: Int[np.ndarray, "n"]) -> "Detections":
        """The detections in frames of given numbers; nothing in those that are missing here."""
        rows = [self._rows_of_frames.get(int(number), -1) for number in numbers]

        def spread(part: np.ndarray, nothing: float) -> np.ndarray:
            return np.concatenate((part, np.full((1, *part.shape[1:]), nothing)))[rows]

        return replace(
            self,
            picture=None if self.picture is None else spread(self.picture, np.nan),
            space=None if self.space is None else spread(self.space, np.nan),
            confidence=spread(self.confidence, 0.0),
            frame=np.array(numbers, dtype=np.int64),
            label=tuple((*self.label, None)[row] for row in rows),
            score=spread(self.score, np.nan),
            image=None if self.image is None else tuple((*self.image, "")[row] for row in rows),
            cov_px=None if self.cov_px is None else spread(self.cov_px, np.nan),
        )

    def at_frame(self, number: int) -> HandDetection | None:
        """The hand in the frame of a number; None where the file has no such frame, or no hand in it."""
        return self._at(self._rows_of_frames.get(number))

    def in_picture(self, name: str) -> HandDetection | None:
        """The hand in the picture of a name; None where the file has no such picture, or no hand in it."""
        return self._at(self.image.index(name) if self.image is not None and name in self.image else None)

    @cached_property
    def _rows_of_frames(self) -> dict[int, int]:
        return {int(number): row for row, number in enumerate(self.frame)}

    def _at(self, row: int | None) -> HandDetection | None:
        if row is None or not self.confidence[row].any():
            return None
        return HandDetection(
            picture=None if self.picture is None else self.picture[row],
            space=None if self.space is None else self.space[row],
            confidence=self.confidence[row],
            label=self.label[row],
            score=float(self.score[row]),
        )


def detections_of(
    where: str,
    rows: Sequence[tuple[int, HandDetection | None]],
    *,
    side: Side | None,
    is_normalised: bool = False,
    image: tuple[str, ...] | None = None,
) -> Detections:
    """The record of numbered frames; a frame without a hand has None. Hands that are labelled as the other one are no
    hands.

    Raises InputError where no frame has a hand.
    """
    labels: tuple[Side | None, ...] = tuple(None if hand is None else hand.label for _, hand in rows)
    score = np.array([np.nan if hand is None else hand.score for _, hand in rows], dtype=np.float64)
    hands = [None if hand is None or (side and hand.label not in (side, None)) else hand for _, hand in rows]
    confidence = np.stack([_confidence(hand) for hand in hands])
    picture = _stacked([None if hand is None else hand.picture for hand in hands], 2)
    space = _stacked([None if hand is None else hand.space for hand in hands], 3)
    is_known = np.zeros(confidence.shape, dtype=bool)
    for points in (picture, space):
        if points is not None:
            points[~np.isfinite(points).all(-1) | ~(confidence > 0)] = np.nan
            is_known |= np.isfinite(points).all(-1)
    if not is_known.any():
        of_side = "" if side is None else f" {side}"
        raise InputError(f"{where}: expected at least one{of_side} hand, got none in {len(rows)} frames")
    return Detections(
        picture=picture,
        space=space,
        confidence=np.where(is_known, confidence, 0.0),
        frame=np.array([number for number, _ in rows], dtype=np.int64),
        label=labels,
        score=score,
        side=side,
        is_normalised=is_normalised and picture is not None,
        image=image,
    )


def majority_side(labels: Sequence[Side | None]) -> Side | None:
    """The side that is told more often, right where both are; None where neither is."""
    left, right = list(labels).count("left"), list(labels).count("right")
    return None if not left + right else "left" if left > right else "right"


def _confidence(hand: HandDetection | None) -> Float64[np.ndarray, "21"]:
    """Confidence of every point; what is no number is 0."""
    if hand is None:
        return np.zeros(COUNT)
    return np.ones(COUNT) if hand.confidence is None else np.nan_to_num(hand.confidence, posinf=0.0).astype(np.float64)


def _stacked(rows: Sequence[np.ndarray | None], dimension: int) -> Float64[np.ndarray, "frames 21 d"] | None:
    if all(points is None for points in rows):
        return None
    empty = np.full((COUNT, dimension), np.nan)
    return np.stack([empty if points is None else points[:, :dimension].astype(np.float64) for points in rows])
