"""What a detector found while a run went on: exact to the last bit, and as arrays that are read like any other."""

import math
from pathlib import Path

import numpy as np
import pytest

from torchhand.errors import InputError
from torchhand.files import DetectionLog, HandDetection, read_detections, save_detections
from torchhand.hand import Side


def _hand(seed: int, side: Side | None = "right") -> HandDetection:
    generator = np.random.default_rng(seed)
    points, space = generator.uniform(0, 640, (21, 2)), generator.normal(size=(21, 3))
    points[seed] = np.nan
    return HandDetection(picture=points, space=space, confidence=None, label=side, score=generator.uniform())


def _same(one: HandDetection | None, other: HandDetection | None) -> bool:
    if one is None or other is None:
        return one is other
    assert one.picture is not None
    assert other.picture is not None
    assert one.space is not None
    assert other.space is not None
    arrays = np.array_equal(one.picture, other.picture, equal_nan=True) and np.array_equal(one.space, other.space)
    return arrays and one.label == other.label and one.score == other.score


def test_what_an_earlier_run_found_comes_back_to_the_last_bit(tmp_path: Path) -> None:
    path = tmp_path / "keypoints.jsonl"
    found = {(0, 0): _hand(1), (1, 0): None, (0, 1): _hand(2, "left"), (1, 1): _hand(3, None), (0, 2): _hand(4)}
    log = DetectionLog(path)
    for (view, frame), hand in found.items():
        log.append(view, frame, hand, number=frame)
    log.close()
    again = DetectionLog(path, keep_before=2)
    for (view, frame), hand in found.items():
        assert again.holds(view, frame) == (frame < 2)
        if frame < 2:
            assert _same(again.hand(view, frame), hand)
    again.append(0, 2, found[0, 2], number=2)
    again.close()
    assert len(path.read_text().splitlines()) == 5


def test_a_line_that_was_never_finished_is_dropped(tmp_path: Path) -> None:
    path = tmp_path / "keypoints.jsonl"
    log = DetectionLog(path)
    log.append(0, 0, _hand(1), number=0)
    log.append(0, 1, _hand(2), number=1)
    log.close()
    path.write_bytes(path.read_bytes()[:-20])
    again = DetectionLog(path, keep_before=9)
    again.close()
    assert again.holds(0, 0)
    assert not again.holds(0, 1)
    assert len(path.read_text().splitlines()) == 1


def test_a_new_run_begins_with_nothing(tmp_path: Path) -> None:
    path = tmp_path / "keypoints.jsonl"
    path.write_text('{"view":0,"frame":0}\n')
    log = DetectionLog(path)
    log.close()
    assert not log.holds(0, 0)
    assert path.read_text() == ""


def test_a_file_of_something_else_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "keypoints.jsonl"
    path.write_text('{"points_px":3}\n')
    with pytest.raises(InputError, match="holds no detections that can be read"):
        DetectionLog(path, keep_before=1)


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_arrays_are_read_like_any_file_of_keypoints(tmp_path: Path, side: Side) -> None:
    log = DetectionLog(tmp_path / "keypoints.jsonl")
    found = [_hand(1, side), None, _hand(2, side)]
    for frame, hand in enumerate(found):
        log.append(0, 5 + frame, hand, number=5 + frame)
    log.close()
    save_detections(tmp_path / "keypoints.jsonl", tmp_path, 1)
    read = read_detections(tmp_path / "keypoints.npz", side=side)
    assert read.at_frame(6) is None
    for frame, hand in enumerate(found):
        if hand is not None:
            seen = read.at_frame(5 + frame)
            assert seen is not None
            is_known = np.isfinite(seen.picture[:, 0]) if seen.picture is not None else np.zeros(21, dtype=bool)
            assert hand.picture is not None
            assert seen.picture is not None
            assert np.array_equal(seen.picture[is_known], hand.picture[is_known])
            assert list(is_known) == list(np.isfinite(hand.picture[:, 0]))
            assert (seen.label, seen.score) == (side, hand.score)
    with pytest.raises(InputError, match="got none in 3 frames"):
        read_detections(tmp_path / "keypoints.npz", side="left" if side == "right" else "right")


def test_each_view_has_arrays_of_its_own(tmp_path: Path) -> None:
    log = DetectionLog(tmp_path / "keypoints.jsonl")
    for view in (0, 1):
        log.append(view, 0, _hand(1 + view) if view else None, number=0)
    log.close()
    save_detections(tmp_path / "keypoints.jsonl", tmp_path, 2)
    assert sorted(path.name for path in tmp_path.glob("*.npz")) == ["keypoints_0.npz", "keypoints_1.npz"]
    with np.load(tmp_path / "keypoints_0.npz") as nothing:
        assert nothing["label"].tolist() == [""]
        assert math.isnan(nothing["score"][0])
        assert np.isnan(nothing["points_px"]).all()
    assert read_detections(tmp_path / "keypoints_1.npz", side="right").at_frame(0) is not None


def test_arrays_are_numbered_as_the_camera_s_own_pictures(tmp_path: Path) -> None:
    """Two frames of a recording of which a camera gave its pictures 4 and 6, and one of which it gave none."""
    log = DetectionLog(tmp_path / "keypoints.jsonl")
    for frame, number in enumerate((4, None, 6)):
        log.append(0, frame, _hand(1 + frame) if number else None, number=number)
    log.close()
    save_detections(tmp_path / "keypoints.jsonl", tmp_path, 1)
    found = read_detections(tmp_path / "keypoints.npz", side="right")
    assert found.frame.tolist() == [4, 6]
    assert _same(found.at_frame(6), _hand(3))
    again = DetectionLog(tmp_path / "keypoints.jsonl", keep_before=3)
    assert [again.holds(0, frame) for frame in range(4)] == [True, True, True, False]
    again.close()
