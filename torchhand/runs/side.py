"""Which hand a recording shows: as the user says, as a detector's labels or hands of both sides in the hulls of several
cameras tell, or as is assumed."""

import itertools
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import torch

from torchhand.cluster import side_by_side
from torchhand.detect import HandDetector
from torchhand.devices import HOST
from torchhand.files import read_detections
from torchhand.hand import Side
from torchhand.runs.recordings import Recording

_FRAMES = 30  # labelled frames that are asked
_WRONG = 0.05
"""Share of recordings in which a label is wrong throughout, a cautious guess: none of 27 recordings of known sides was,
and 0.2 % of their 2,700 frames."""
_ALIKE = 10.0  # frames that err together, and count as one
_LOG_ODDS = 60.0
"""Log odds of a side for every unit by which its hand explains frames better in the mean. On rigs of known sides the
right one was better by 0.05 to 0.11 (docs/measured.md); this calls 0.05 a probability of 0.95."""
_MOST_LOG_ODDS = 4.0  # that hands of both sides tell: few rigs were tried
_RIGHT_BEFORE = 0.9
"""Probability of a right hand where the user, who can tell, says nothing: a guess."""


HandsOfSide = Callable[[Side], Mapping[int, float]]
"""How well a hand of a side explains frames of a rig, by their indices: the parts of the silhouettes and of their edges
that it explains, in the mean. Frames in which none is found are missing. Changes nothing here: it is called in a copy
of this process where that can be made."""


@dataclass(frozen=True, kw_only=True)
class FoundSide:
    """A side, and how it is known."""

    side: Side
    source: Literal["given", "inferred", "tried", "assumed"]
    probability: float | None = None
    """Probability of this side by the detector's labels, or by hands of both sides; None where there are none."""
    frames: int = 0
    """Labels that were counted, or frames in which a hand was tried."""

    def notes(self) -> list[str]:
        """What the user should know of it."""
        if self.probability is None:
            return []
        if self.source == "tried":
            told = f"a {self.side} hand, with probability {self.probability:.2f} by hands of both sides"
            return [f"{told} tried on {self.frames} frames; --side overrides"]
        if self.source == "inferred":
            told = (
                f"a {self.side} hand, with probability {self.probability:.3f} by {self.frames} labels of the detector"
            )
            return [f"{told}; --side overrides"]
        if self.probability < _WRONG:
            other = "left" if self.side == "right" else "right"
            told = f"the detector sees a {other} hand, with probability {1 - self.probability:.3f}"
            return [f"a {self.side} hand was asked for, but {told} by {self.frames} labels"]
        return []


def find_side(
    given: Side | None,
    recording: Recording,
    *,
    keypoints: Sequence[Path] = (),
    has_detector: bool = False,
    hand_model: Path | None = None,
    trial: HandsOfSide | None = None,
    device: torch.device = HOST,
) -> FoundSide:
    """The side of the hand in a recording; right where nothing tells.

    given: by the user. keypoints: files of detections. has_detector: whether MediaPipe is to be asked about the first
    frames; a webcam's frames do not come again, so it is not asked about these. trial: tells hands
    of both sides apart where no detector is asked; it computes on the device.

    Raises InputError for files that cannot be read, and where MediaPipe is to be asked and is not installed.
    """
    labels: list[Side | None] = []
    for path in keypoints:
        seen = read_detections(path).label
        labels.extend(itertools.islice((label for label in seen if label is not None), _FRAMES))
    if has_detector and given is None and not getattr(recording, "is_live", False):
        labels += _detected(recording, hand_model)
    told, right = sum(label is not None for label in labels), probability_of_right(labels)
    if given is not None:
        own = None if right is None else (right if given == "right" else 1 - right)
        return FoundSide(side=given, source="given", probability=own, frames=told)
    source: Literal["inferred", "tried"] = "inferred"
    if right is None and trial is not None and not (keypoints or has_detector):
        source, (right, told) = "tried", _tried(trial, device)
    if right is None:
        return FoundSide(side="right", source="assumed")
    side: Side = "right" if right >= 0.5 else "left"
    return FoundSide(side=side, source=source, probability=max(right, 1 - right), frames=told)


def probability_of_right(labels: Sequence[Side | None]) -> float | None:
    """Probability that the hand is a right one, both sides being equally likely beforehand; None without a label."""
    counts = Counter(label for label in labels if label is not None)
    total = counts["left"] + counts["right"]
    if not total:
        return None
    votes = (counts["right"] - counts["left"]) / total * max(1.0, total / _ALIKE)
    return 1 / (1 + math.exp(-votes * math.log((1 - _WRONG) / _WRONG)))


def _detected(recording: Recording, hand_model: Path | None) -> list[Side | None]:
    """MediaPipe's labels in the first frames of all views."""
    found: list[Side | None] = []
    detectors = [HandDetector(hand_model=hand_model) for _ in recording.cameras]
    try:
        with recording.opened(0) as frames:
            for _, frame in zip(range(_FRAMES), frames, strict=False):
                for view, detector in zip(frame.views, detectors, strict=True):
                    if view.image is None:
                        continue
                    before, hand = detector.other_hands, detector.detect(view.image)
                    own = None if hand is None else hand.label
                    found.append("left" if detector.other_hands > before else own)
    finally:
        for detector in detectors:
            detector.close()
    return found


def _tried(trial: HandsOfSide, device: torch.device) -> tuple[float | None, int]:
    """Probability of a right hand by hands of both sides, and the frames in which one of them was found."""
    right, left = side_by_side([partial(trial, "right"), partial(trial, "left")], device)
    return probability_of_right_tried(right, left), len({**right, **left})


def probability_of_right_tried(right: Mapping[int, float], left: Mapping[int, float]) -> float | None:
    """Probability of a right hand by how well a right and a left hand explain frames (`HandsOfSide`); None where
    neither was found. A frame without a hand is not explained by it."""
    frames = len({**right, **left})
    if not frames:
        return None
    told = _LOG_ODDS * (sum(right.values()) - sum(left.values())) / frames
    told = max(-_MOST_LOG_ODDS, min(_MOST_LOG_ODDS, told))
    return 1 / (1 + math.exp(-told) * (1 - _RIGHT_BEFORE) / _RIGHT_BEFORE)
