"""What a detector found while a run went on: a file that grows by a line per view and frame, and arrays afterwards."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from torchhand.errors import InputError
from torchhand.files.detections.record import COUNT, HandDetection, Side
from torchhand.files.disk import LineFile, read_lines, replacing

KEYPOINTS_NAME = "keypoints.npz"
"""What `save_detections` writes of one camera."""

_LABELS: Mapping[Side | None, str] = {"right": "Left", "left": "Right", None: ""}
"""Labels as MediaPipe's solutions give them: of a mirror image, as `read_detections` takes them."""


class DetectionLog:
    """One hand or none of every frame of every view, exact to the last bit.

    Raises InputError where the file cannot be written, or holds something else.
    """

    def __init__(self, path: Path, *, keep_before: int = 0) -> None:
        """keep_before: number of the frame from which on all that the file holds already is dropped."""
        self._earlier: dict[tuple[int, int], HandDetection | None] = {}
        size = 0
        if keep_before and path.exists():
            for line in _lines(path):
                if line.place[1] >= keep_before:
                    break
                self._earlier[line.place], size = line.hand, line.end
        self._lines = LineFile(path, size=size)

    def holds(self, view: int, frame: int) -> bool:
        """Whether the hand was looked for in a frame of a view: by an earlier run, or before the last recall."""
        return (view, frame) in self._earlier

    def hand(self, view: int, frame: int) -> HandDetection | None:
        """What was found then; None where nothing was."""
        return self._earlier.get((view, frame))

    def recall(self) -> None:
        """Hold all that this run has found too."""
        self._earlier |= {line.place: line.hand for line in _lines(self._lines.path)}

    def append(self, view: int, frame: int, hand: HandDetection | None, *, number: int | None) -> None:
        """Add a frame of a view. number: of its picture among the camera's own; None where it has none."""
        content: dict[str, Any] = {"view": view, "frame": frame}
        if number != frame:
            content["number"] = number
        if hand is not None and hand.picture is not None:
            content |= {"label": _LABELS[hand.label], "score": _number(hand.score)}
            content["points_px"] = [[_number(x) for x in point] for point in hand.picture[:, :2]]
            if hand.space is not None:
                content["world"] = [[_number(x) for x in point] for point in hand.space]
        self._lines.append(json.dumps(content, allow_nan=False, separators=(",", ":")))

    def close(self) -> None:
        self._lines.close()


def save_detections(log: Path, folder: Path, views: int) -> None:
    """Write what a log holds as arrays that `read_detections` reads: keypoints.npz, or of several views one file each,
    keypoints_0.npz and so on, numbered as the camera's own pictures. A view in which nothing was ever found gets its
    file too."""
    rows: list[dict[int, HandDetection | None]] = [{} for _ in range(views)]
    for line in _lines(log):
        if line.place[0] < views and line.number is not None:
            rows[line.place[0]][line.number] = line.hand
    for view, found in enumerate(rows):
        hands = [found[frame] for frame in sorted(found)]
        arrays = {
            "frame": np.array(sorted(found), dtype=np.int64),
            "points_px": _stacked([None if hand is None else hand.picture for hand in hands], 2),
            "world": _stacked([None if hand is None else hand.space for hand in hands], 3),
            "label": np.array(["" if hand is None else _LABELS[hand.label] for hand in hands], dtype="<U5"),
            "score": np.array([np.nan if hand is None else hand.score for hand in hands], dtype=np.float64),
        }
        path = folder / (f"keypoints_{view}.npz" if views > 1 else KEYPOINTS_NAME)
        with replacing(path) as temporary, temporary.open("wb") as file:
            np.savez(file, **arrays)  # pyright: ignore[reportArgumentType] - the stub lacks keyword arrays


class _Line(NamedTuple):
    """What was found at one place."""

    place: tuple[int, int]
    """View and frame."""
    number: int | None
    """Of the picture among its camera's own."""
    hand: HandDetection | None
    end: int
    """Offset of the line's end in the file."""


def _lines(path: Path) -> Iterator[_Line]:
    sides: dict[str, Side | None] = {label: side for side, label in _LABELS.items()}
    for content, end in read_lines(path):
        try:
            hand = None
            if "points_px" in content:
                hand = HandDetection(
                    picture=_array(content["points_px"], 2),
                    space=_array(content["world"], 3) if "world" in content else None,
                    confidence=None,
                    label=sides[content["label"]],
                    score=float("nan") if content["score"] is None else float(content["score"]),
                )
            place = int(content["view"]), int(content["frame"])
            number = content.get("number", place[1])
            yield _Line(place, None if number is None else int(number), hand, end)
        except (KeyError, TypeError, ValueError) as error:
            told = f"{type(error).__name__}: {error}"
            raise InputError(f"{path}: holds no detections that can be read ({told})") from error


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _array(rows: Any, dimension: int) -> np.ndarray:
    return np.array(rows, dtype=np.float64).reshape(COUNT, dimension)


def _stacked(rows: list[np.ndarray | None], dimension: int) -> np.ndarray:
    empty = np.full((COUNT, dimension), np.nan)
    found = [empty if points is None else points[:, :dimension] for points in rows]
    return np.stack(found) if found else np.empty((0, COUNT, dimension))
