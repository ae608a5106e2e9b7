"""Which hand is followed: as given, as a detector's labels tell, or as assumed."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from torchhand.hand import Side
from torchhand.runs.recordings import OneCameraRecording
from torchhand.runs.side import find_side, probability_of_right, probability_of_right_tried

FRAMES = 40


@pytest.fixture
def write(tmp_path: Path) -> Any:
    """A file of MediaPipe's points, whose labels are those of mirrored pictures: its Left is a right hand."""

    def write(labels: list[str]) -> Path:
        points = np.random.default_rng(0).uniform(20, 100, (len(labels), 21, 2))
        points[np.array(labels) == ""] = np.nan
        np.savez(tmp_path / "hands.npz", points_px=points, label=np.array(labels), score=np.ones(len(labels)))
        return tmp_path / "hands.npz"

    return write


@pytest.fixture
def recording(tmp_path: Path) -> OneCameraRecording:
    (tmp_path / "pictures").mkdir()
    cv2.imwrite(str(tmp_path / "pictures" / "0.png"), np.zeros((24, 32, 3), np.uint8))
    return OneCameraRecording(tmp_path / "pictures", None)


@pytest.fixture
def found(recording: OneCameraRecording) -> Any:
    def found(given: Any, *paths: Path) -> Any:
        return find_side(given, recording, keypoints=paths)

    return found


@pytest.mark.parametrize(("label", "side"), [("Left", "right"), ("Right", "left")])
def test_the_labels_decide_where_nothing_is_given(write: Any, found: Any, label: str, side: str) -> None:
    side_found = found(None, write([""] * 5 + [label] * FRAMES))
    assert (side_found.side, side_found.source) == (side, "inferred")
    assert side_found.frames == 30
    assert side_found.probability > 0.999
    (note,) = side_found.notes()
    assert f"a {side} hand, with probability 1.000 by 30 labels" in note


def test_what_is_given_counts_and_a_contradiction_is_told(write: Any, found: Any) -> None:
    path = write(["Left"] * FRAMES)
    assert found("right", path).notes() == []
    wrong = found("left", path)
    assert (wrong.side, wrong.source) == ("left", "given")
    (note,) = wrong.notes()
    assert "a left hand was asked for, but the detector sees a right hand" in note


def test_without_labels_a_right_hand_is_assumed(found: Any) -> None:
    side = found(None)
    assert (side.side, side.source, side.probability) == ("right", "assumed", None)
    assert side.notes() == []
    assert found("left").notes() == []


def probability(right: int, left: int = 0) -> float | None:
    labels: list[Side | None] = []
    for _ in range(right):
        labels.append("right")
    for _ in range(left):
        labels.append("left")
    return probability_of_right(labels)


def test_the_probability_knows_that_frames_err_together() -> None:
    assert probability(0) is None
    assert probability_of_right([None]) is None
    assert probability(1) == pytest.approx(0.95)
    assert probability(10) == pytest.approx(0.95)
    assert probability(1, 1) == pytest.approx(0.5)
    assert probability(30) == pytest.approx(1 / (1 + 19.0**-3))
    assert probability(7, 3) == pytest.approx(1 / (1 + 19.0**-0.4))
    assert probability(3, 7) == pytest.approx(1 / (1 + 19.0**0.4))


def test_files_of_several_cameras_count_together(write: Any, found: Any, tmp_path: Path) -> None:
    first = write(["Left"] * 3)
    other = first.rename(tmp_path / "other.npz")
    both = found(None, other, write(["Right"] * FRAMES))
    assert (both.side, both.frames) == ("left", 33)


def test_hands_of_both_sides_tell_where_nothing_else_does(write: Any, recording: OneCameraRecording) -> None:
    def trial(side: Side) -> dict[int, float]:
        return {3: 0.93, 7: 0.91} if side == "left" else {3: 0.82}

    tried = find_side(None, recording, trial=trial)
    assert (tried.side, tried.source, tried.frames) == ("left", "tried", 2)
    (note,) = tried.notes()
    assert note == "a left hand, with probability 0.86 by hands of both sides tried on 2 frames; --side overrides"

    def never(side: Side) -> dict[int, float]:
        pytest.fail("tried though something tells")

    assert find_side("right", recording, trial=never).source == "given"
    assert find_side(None, recording, keypoints=[write(["Left"] * FRAMES)], trial=never).source == "inferred"
    nothing = find_side(None, recording, trial=lambda side: {})
    assert (nothing.side, nothing.source, nothing.probability) == ("right", "assumed", None)


def test_a_left_hand_has_to_explain_more_than_a_right_one() -> None:
    """For nine in ten who name no side film a right hand."""
    assert probability_of_right_tried({}, {}) is None
    assert probability_of_right_tried({0: 0.9}, {0: 0.9}) == pytest.approx(0.9)
    more = probability_of_right_tried({0: 0.90}, {0: 0.93})
    assert more is not None
    assert 0.5 < more < 0.9
    less = probability_of_right_tried({0: 0.85, 1: 0.85}, {0: 0.91, 1: 0.91})
    assert less is not None
    assert less < 0.3
    assert probability_of_right_tried({0: 0.9}, {0: 0.9, 1: 0.9}) == pytest.approx(1 / (1 + np.exp(4.0) / 9))
