"""overlay.mp4: drawn from the saved track in a second pass over the pictures, or live where they come only once."""

import contextlib
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor
from tqdm import tqdm

from torchhand.draw import draw_overlay, overlay_size
from torchhand.files import FrameRecord, Track, open_source, write_video
from torchhand.hand import HandPose
from torchhand.image import WORKING_PIXELS, PicturePart
from torchhand.numerics import single_threaded
from torchhand.runs.recordings import LiveCamera, OneCameraRecording, RecordedFrame
from torchhand.runs.records import undetermined_fingers
from torchhand.view import HandProjector

Draw = Callable[[HandProjector | None, RecordedFrame, FrameRecord], None]


def overlay_frames(
    track: Track, projector: HandProjector, source: str | Path
) -> Iterator[UInt8[Tensor, "height width 3"]]:
    """The pictures of a track with what was found drawn over them; black where a picture cannot be read."""
    return (picture for _, picture in _timed_frames(track, projector, source))


def _timed_frames(
    track: Track, projector: HandProjector, source: str | Path
) -> Iterator[tuple[float, UInt8[Tensor, "height width 3"]]]:
    """The same, with when they are shown since the first one."""
    if not len(track):
        return
    first, last = int(track.frame[0]), int(track.frame[-1])
    rows = {int(frame): row for row, frame in enumerate(track.frame)}
    first_s: float | None = None
    overlaps = track.measures.get("overlap", np.full(len(track), np.nan))
    with open_source(source, start=first, max_frames=last + 1 - first) as frames:
        for frame in frames:
            row = rows.get(frame.index)
            if row is None:
                continue
            first_s = frame.time_s if first_s is None else first_s
            yield (
                frame.time_s - first_s,
                _drawn(
                    frame.image if frame.image is not None else _black(frames.width, frames.height),
                    projector,
                    status=str(track.status[row]),
                    frame=frame.index,
                    pose=track.pose[row],
                    keypoints_px=None if track.keypoints2d is None else track.keypoints2d[row],
                    overlap=float(overlaps[row]),
                    finger_quality=None if track.finger_quality is None else track.finger_quality[row],
                ),
            )


def write_overlay(path: Path, track: Track, projector: HandProjector, source: str | Path, fps: float) -> None:
    """The whole overlay video; `projector` holds the camera frame's camera and the fitted shape."""
    camera = projector.camera
    width, height = overlay_size(*_shown(camera.width, camera.height).size)
    with (
        write_video(path, width=width, height=height, fps=fps) as video,
        tqdm(total=len(track), desc="overlay", unit="frame", disable=not sys.stderr.isatty()) as bar,
    ):
        for time_s, picture in _timed_frames(track, projector, source):
            video.write(picture, time_s=time_s)
            bar.update()


@contextlib.contextmanager
def draw_live(path: Path | None, recording: OneCameraRecording | LiveCamera) -> Iterator[Draw]:
    """Hands out a function that draws each frame as it is tracked; without a path it does nothing."""
    if path is None:
        yield lambda projector, frame, record: None
        return
    width, height = overlay_size(*_shown(recording.width, recording.height).size)
    with write_video(path, width=width, height=height, fps=recording.fps) as video:
        first_s: list[float] = []

        def draw(projector: HandProjector | None, frame: RecordedFrame, record: FrameRecord) -> None:
            image = frame.views[0].image
            image = _black(recording.width, recording.height) if image is None else image
            if projector is None:
                return
            picture = drawn_over(image, projector, record)
            first_s.extend([] if first_s else [frame.time_s])
            video.write(picture, time_s=frame.time_s - first_s[0])

        yield draw


def drawn_over(
    image: UInt8[Tensor, "height width 3"], projector: HandProjector, record: FrameRecord
) -> UInt8[Tensor, "overlay_height overlay_width 3"]:
    """A picture with what was found in it."""
    return _drawn(
        image,
        projector,
        status=record.status,
        frame=record.frame,
        pose=record.pose,
        keypoints_px=record.keypoints2d,
        overlap=record.measures.get("overlap", float("nan")),
        finger_quality=record.finger_quality,
    )


def _shown(width: int, height: int) -> PicturePart:
    """A picture at the size in which it is shown."""
    return PicturePart.of((0, 0), (width, height), WORKING_PIXELS)


def _black(width: int, height: int) -> UInt8[Tensor, "height width 3"]:
    return torch.zeros(height, width, 3, dtype=torch.uint8)


@torch.inference_mode()
@single_threaded()
def _drawn(
    image: UInt8[Tensor, "height width 3"],
    projector: HandProjector,
    *,
    status: str,
    frame: int,
    pose: np.ndarray,
    keypoints_px: np.ndarray | None,
    overlap: float,
    finger_quality: np.ndarray | None,
) -> UInt8[Tensor, "overlay_height overlay_width 3"]:
    has_pose = bool(np.isfinite(pose).all())
    part = _shown(image.shape[1], image.shape[0])
    if part.size != part.part:
        camera = projector.camera.of_part(part.corner, part.part, part.size)
        image, projector = part.image(image), HandProjector(projector.kinematics, camera, projector.shape)
        keypoints_px = None if keypoints_px is None else part.part_px(keypoints_px)
    return draw_overlay(
        image,
        projector,
        HandPose.of(torch.tensor(pose, dtype=torch.float64)) if has_pose else None,
        status=status,
        frame=frame,
        keypoints_px=torch.tensor(keypoints_px, dtype=torch.float64) if has_pose and keypoints_px is not None else None,
        iou=overlap if np.isfinite(overlap) else None,
        undetermined=undetermined_fingers(finger_quality),
    )
