"""Keypoints of a recording, view by view and frame by frame: what gives them, and those that are read from files."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol, runtime_checkable

from jaxtyping import Float
from torch import Tensor

from torchhand.detect import hand_keypoints
from torchhand.errors import InputError
from torchhand.files import read_detections
from torchhand.geometry import Camera
from torchhand.hand import Side
from torchhand.runs.recordings import RecordedFrame
from torchhand.track import HandKeypoints


@runtime_checkable
class KeypointSource(Protocol):
    """What gives the keypoints of a recording's frames."""

    def hands(
        self, frame: RecordedFrame, followed_px: Float[Tensor, "views 21 2"] | None
    ) -> Sequence[HandKeypoints | None]:
        """The hand of every view. followed_px: keypoints of the hand as last tracked; None before there is one."""
        ...

    def tells_absence(self, frame: RecordedFrame) -> Sequence[bool]:
        """Of every view, whether the hand is not in it where it is not among those given: not where hands of the other
        side were seen, which may be this one under the wrong name, nor where nothing was looked for."""
        ...

    def rewind(self) -> None:
        """Get ready to give the same hands again, in any order of the frames."""
        ...


def with_keypoints(
    frame: RecordedFrame, source: KeypointSource | None, followed_px: Float[Tensor, "views 21 2"] | None
) -> RecordedFrame:
    """The frame with the keypoints of its views, or the detector's silence; a view whose picture is missing has
    neither."""
    if source is None:
        return frame
    hands = source.hands(frame, followed_px)
    views = [
        view if view.is_empty else replace(view, keypoints=seen, is_detector_silent=seen is None and tells)
        for view, seen, tells in zip(frame.views, hands, source.tells_absence(frame), strict=True)
    ]
    return replace(frame, views=tuple(views))


class KeypointTracks:
    """One file of detections per camera, in the cameras' order (`KeypointSource`).

    A file may hold points in the picture, points in space up to a similarity (such as MediaPipe's world landmarks), or
    both; points in space alone cannot be used, as they do not tell where the hand is.
    """

    def __init__(
        self, paths: Sequence[Path], cameras: Sequence[Camera], *, side: Side = "right", start: int = 0
    ) -> None:
        """side: of the hand that is tracked; those of the other side are left out. start: first frame that is wanted.

        Raises InputError for files that cannot be read, that hold no points in the picture, or none of these frames,
        or are not one a camera.
        """
        if len(paths) != len(cameras):
            raise InputError(f"--keypoints: expected one file per camera, {len(cameras)}, got {len(paths)}")
        self._views = [_View(path, camera, side) for path, camera in zip(paths, cameras, strict=True)]
        for path, view in zip(paths, self._views, strict=True):
            if view.last < start:
                raise InputError(f"{path}: expected keypoints of frame {start} or later, got those of 0 to {view.last}")

    def hands(
        self, frame: RecordedFrame, followed_px: Float[Tensor, "views 21 2"] | None
    ) -> list[HandKeypoints | None]:
        """What was found in a frame, view by view; None where nothing was."""
        return [view.hand(frame.number(place)) for place, view in enumerate(self._views)]

    def tells_absence(self, frame: RecordedFrame) -> list[bool]:
        """Of every view, whether its file knows of the frame, and holds no hands of the other side."""
        return [view.tells_absence(frame.number(place)) for place, view in enumerate(self._views)]

    def rewind(self) -> None:
        """Files can be read in any order."""


class _View:
    """The detections of one camera."""

    def __init__(self, path: Path, camera: Camera, side: Side) -> None:
        self._found = read_detections(path, side=side)
        if self._found.picture is None:
            raise InputError(f"{path}: expected points in the picture, got points in space alone")
        self._pixels = self._found.in_pixels(camera.width, camera.height)
        self._has_other_hands = any(label not in (side, None) for label in self._found.label)
        self.last = int(self._found.frame.max()) if len(self._found) else -1

    def tells_absence(self, number: int | None) -> bool:
        return number is not None and number <= self.last and not self._has_other_hands

    def hand(self, number: int | None) -> HandKeypoints | None:
        if number is None:
            return None
        seen, in_picture = self._found.at_frame(number), self._pixels.at_frame(number)
        if seen is None or in_picture is None:
            return None
        return hand_keypoints(replace(seen, picture=in_picture.picture, confidence=in_picture.confidence))
