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

    def sees_other_hands(self) -> Sequence[bool]:
        """Of every view, whether hands of the other side were seen, which may be this one under the wrong name."""
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
        view
        if view.is_empty
        else replace(view, keypoints=seen, is_detector_silent=seen is None and not sees_other_hands)
        for view, seen, sees_other_hands in zip(frame.views, hands, source.sees_other_hands(), strict=True)
    ]
    return replace(frame, views=tuple(views))


class KeypointTracks:
    """One file of detections per camera, in the cameras' order (`KeypointSource`).

    A file may hold points in the picture, points in space up to a similarity (such as MediaPipe's world landmarks), or
    both; points in space alone cannot be used, as they do not tell where the hand is.
    """

    def __init__(self, paths: Sequence[Path], cameras: Sequence[Camera], *, side: Side = "right") -> None:
        """side: of the hand that is tracked; those of the other side are left out.

        Raises InputError for files that cannot be read, that hold no points in the picture, or are not one a camera.
        """
        if len(paths) != len(cameras):
            raise InputError(f"--keypoints: expected one file per camera, {len(cameras)}, got {len(paths)}")
        self._views = [_View(path, camera, side) for path, camera in zip(paths, cameras, strict=True)]

    def hands(
        self, frame: RecordedFrame, followed_px: Float[Tensor, "views 21 2"] | None
    ) -> list[HandKeypoints | None]:
        """What was found in a frame, view by view; None where nothing was."""
        return [view.hand(frame.number(place)) for place, view in enumerate(self._views)]

    def sees_other_hands(self) -> list[bool]:
        """Whether a camera's file holds hands of the other side."""
        return [view.has_other_hands for view in self._views]

    def rewind(self) -> None:
        """Files can be read in any order."""


class _View:
    """The detections of one camera."""

    def __init__(self, path: Path, camera: Camera, side: Side) -> None:
        self._found = read_detections(path, side=side)
        if self._found.picture is None:
            raise InputError(f"{path}: expected points in the picture, got points in space alone")
        self._pixels = self._found.in_pixels(camera.width, camera.height)
        self.has_other_hands = any(label not in (side, None) for label in self._found.label)

    def hand(self, number: int | None) -> HandKeypoints | None:
        if number is None:
            return None
        seen, in_picture = self._found.at_frame(number), self._pixels.at_frame(number)
        if seen is None or in_picture is None:
            return None
        return hand_keypoints(replace(seen, picture=in_picture.picture, confidence=in_picture.confidence))
