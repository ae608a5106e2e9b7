"""Detectors that run along: what they find is kept, and a run that goes on finds what it would have found."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from torchhand.detect import HandDetector, Landmarks
from torchhand.errors import InputError
from torchhand.files import DetectionLog, HandDetection
from torchhand.geometry import Camera, assumed_camera
from torchhand.runs import keypoints_of
from torchhand.runs.detected_tracks import DetectedTracks
from torchhand.runs.keypoint_tracks import with_keypoints
from torchhand.runs.recordings import RecordedFrame
from torchhand.track import View


@dataclass
class Counting:
    """Finds in every picture how many it saw before, on the side that its brightness tells (`Landmarker`)."""

    name: str = "counting"

    def open(self, hands: int) -> Landmarks:
        class Found:
            seen = 0

            def detect(self, image: Tensor) -> Sequence[HandDetection]:
                self.seen += 1
                points = np.full((21, 2), float(self.seen))
                side = "right" if int(image.max()) < 200 else "left"
                return [HandDetection(picture=points, space=None, confidence=None, label=side, score=0.9)][:hands]

            def close(self) -> None:
                pass

        return Found()


@dataclass
class RecordingInMemory:
    """A recording in memory (`Recording`)."""

    frames: list[RecordedFrame]
    cameras: Sequence[Camera] = (assumed_camera(4, 4),)
    name: str = "recording"
    source: str = "memory"
    fps: float = 30.0
    notes: Sequence[str] = field(default_factory=tuple)

    @property
    def count(self) -> int | None:
        return len(self.frames)

    @contextmanager
    def opened(self, done: int) -> Iterator[Iterator[RecordedFrame]]:
        yield iter(self.frames[done:])

    def warnings(self) -> Sequence[str]:
        return ()


def _frames(count: int, *, missing: int | None = None, brightness: int = 0) -> list[RecordedFrame]:
    image = torch.full((4, 4, 3), brightness, dtype=torch.uint8)
    views = [View() if index == missing else View(image=image) for index in range(count)]
    return [
        RecordedFrame(index=index, time_s=index / 30, views=(view,), problems=(None,))
        for index, view in enumerate(views)
    ]


def _points(frame: RecordedFrame, tracks: DetectedTracks) -> float | None:
    seen = with_keypoints(frame, tracks, None).views[0].keypoints
    return None if seen is None else float(seen.points_px[0, 0])


def _tracks(log: DetectionLog | None = None) -> DetectedTracks:
    return DetectedTracks([HandDetector(landmarker=Counting())], log)


def test_a_run_that_goes_on_finds_what_it_would_have_found(tmp_path: Path) -> None:
    frames = _frames(12, missing=3)
    whole_log = DetectionLog(tmp_path / "whole.jsonl")
    whole = _tracks(whole_log)
    expected = [_points(frame, whole) for frame in frames]
    assert expected[2:5] == [3, None, 4]  # a picture that is missing is not seen
    whole_log.close()

    log = DetectionLog(tmp_path / "stopped.jsonl")
    stopped = _tracks(log)
    for frame in frames[:9]:
        _points(frame, stopped)
    log.close()
    log = DetectionLog(tmp_path / "stopped.jsonl", keep_before=6)  # the tracker's state is that after frame 5
    resumed = _tracks(log)
    resumed.catch_up(RecordingInMemory(frames), 6)
    assert [_points(frame, resumed) for frame in frames[4:]] == expected[4:]  # two frames are recalled
    log.close()
    assert (tmp_path / "stopped.jsonl").read_bytes() == (tmp_path / "whole.jsonl").read_bytes()


def test_hands_of_the_other_side_alone_are_told() -> None:
    tracks = _tracks()
    for frame in _frames(3, brightness=255):
        assert _points(frame, tracks) is None
    assert tracks.notes() == ["the detector saw no right hand, but left ones in 3 pictures; is --side wrong?"]
    own = _tracks()
    assert _points(_frames(1)[0], own) == 1
    assert own.notes() == []


def test_a_detector_is_silent_where_it_finds_no_hand_and_has_seen_none_of_the_other_side() -> None:
    class Nothing(Counting):
        def open(self, hands: int) -> Landmarks:
            class Seen:
                def detect(self, image: Tensor) -> Sequence[HandDetection]:
                    return ()

                def close(self) -> None: ...

            return Seen()

    frames = _frames(2, missing=1, brightness=255)
    for landmarker, told in ((Nothing(), [True, False]), (Counting(), [False, False])):
        tracks = DetectedTracks([HandDetector(landmarker=landmarker)])
        views = [with_keypoints(frame, tracks, None).views[0] for frame in frames]
        assert [view.is_detector_silent for view in views] == told


def test_a_hand_is_found_anew_in_pictures_that_do_not_follow_one_another() -> None:
    class Following(Counting):
        """Looks where a hand was first, and elsewhere in the picture after one without a hand."""

        def open(self, hands: int) -> Landmarks:
            class Seen:
                place: int | None = None

                def detect(self, image: Tensor) -> Sequence[HandDetection]:
                    here = int(image.max())
                    if self.place is not None and self.place != here:
                        self.place = None
                        return ()
                    self.place = here
                    points = np.full((21, 2), float(here))
                    return [HandDetection(picture=points, space=None, confidence=None, label="right", score=0.9)]

                def close(self) -> None: ...

            return Seen()

    frames = [frame for level in (10, 20, 30) for frame in _frames(1, brightness=level)]
    for is_sample, expected in ((False, [10, None, 30]), (True, [10, 20, 30])):
        tracks = DetectedTracks([HandDetector(landmarker=Following())], is_sample=is_sample)
        assert [_points(frame, tracks) for frame in frames] == expected


@pytest.mark.parametrize("texts", [["mediapipe", "one.npz"], ["one.npz", "mediapipe"]])
def test_the_detector_is_for_all_cameras_or_none(texts: list[str]) -> None:
    with pytest.raises(InputError, match=r"expected mediapipe alone \(for all cameras\) or files"):
        keypoints_of(texts, None)
