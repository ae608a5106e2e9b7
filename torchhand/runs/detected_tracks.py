"""Keypoints from detectors that run along with a tracker, and what is kept of them."""

import contextlib
import sys
from collections.abc import Iterator, Sequence

from jaxtyping import Float
from torch import Tensor
from tqdm import tqdm

from torchhand.detect import HandDetector, hand_keypoints
from torchhand.files import DetectionLog, TrackWriter, save_detections
from torchhand.files.results import DETECTIONS_NAME
from torchhand.runs.recordings import RecordedFrame, Recording
from torchhand.track import HandKeypoints


class DetectedTracks:
    """One detector per view (`KeypointSource`)."""

    def __init__(
        self, detectors: Sequence[HandDetector], log: DetectionLog | None = None, *, is_sample: bool = False
    ) -> None:
        """log: what an earlier run found, which is not detected again, and where all that is found is kept. is_sample:
        whether the frames do not follow one another: a hand is then not where it was in the one before."""
        self._detectors, self._log = tuple(detectors), log
        self._looks = 2 if is_sample else 1  # the second finds a hand anew, or sees the one of the first better
        self._has_found = False

    def hands(
        self, frame: RecordedFrame, followed_px: Float[Tensor, "views 21 2"] | None
    ) -> list[HandKeypoints | None]:
        """What the detectors find, view by view: of several hands those nearest to the one that is followed."""
        found: list[HandKeypoints | None] = []
        for view, detector in enumerate(self._detectors):
            if self._log is not None and self._log.holds(view, frame.index):
                hand = self._log.hand(view, frame.index)
            else:
                image = frame.views[view].image
                hand = None
                if image is not None:
                    for _ in range(self._looks):
                        hand = detector.detect(image, None if followed_px is None else followed_px[view])
                if self._log is not None:
                    self._log.append(view, frame.index, hand, number=frame.number(view))
            found.append(hand_keypoints(hand))
            self._has_found |= hand is not None
        return found

    def tells_absence(self, frame: RecordedFrame) -> list[bool]:
        """Of every view, whether its detector has seen no pictures with hands of the other side alone."""
        return [detector.other_hands == 0 for detector in self._detectors]

    def rewind(self) -> None:
        """From now on what was found is told again. Raises ValueError where nothing was kept."""
        if self._log is None:
            raise ValueError("detections: expected a log of what was found")
        self._log.recall()

    def catch_up(self, recording: Recording, done: int) -> None:
        """Show new detectors the first `done` frames: what they find depends on the pictures before."""
        with (
            recording.opened(0) as frames,
            tqdm(total=done, desc="detector", unit="frame", dynamic_ncols=True, disable=not sys.stderr.isatty()) as bar,
        ):
            for _, frame in zip(range(done), frames, strict=False):
                for view, detector in zip(frame.views, self._detectors, strict=True):
                    if view.image is not None:
                        detector.detect(view.image)
                bar.update()

    def notes(self) -> list[str]:
        """Whether all that was found were hands of the other side."""
        other = sum(detector.other_hands for detector in self._detectors)
        if self._has_found or not other:
            return []
        side = self._detectors[0].side
        named = "left" if side == "right" else "right"
        return [f"the detector saw no {side} hand, but {named} ones in {other} pictures; is --side wrong?"]


@contextlib.contextmanager
def kept_detections(
    detectors: Sequence[HandDetector], writer: TrackWriter, recording: Recording, first: int
) -> Iterator[DetectedTracks]:
    """Detectors whose findings are kept beside the track: line by line, and as arrays at the end.

    A run that is resumed has what was found before its resume point, and its detectors see those pictures once more.
    """
    done = 0 if writer.resume_point is None else writer.resume_point.last_frame + 1 - first
    path = writer.folder / DETECTIONS_NAME
    log = DetectionLog(path, keep_before=first + done if done else 0)
    try:
        tracks = DetectedTracks(detectors, log)
        if done:
            tracks.catch_up(recording, done)
        yield tracks
    finally:
        for detector in detectors:
            detector.close()
        log.close()
        save_detections(path, writer.folder, len(detectors))
