"""overlay.mp4 of several cameras: drawn from the saved track in a second pass over the pictures."""

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor
from tqdm import tqdm

from torchhand.draw import ViewsOverlay
from torchhand.files import Track, write_video
from torchhand.geometry import Camera
from torchhand.hand import HandKinematics
from torchhand.runs.recordings import RigRecording
from torchhand.runs.records import undetermined_fingers


def view_frames(
    track: Track, overlay: ViewsOverlay, recording: RigRecording
) -> Iterator[tuple[float, UInt8[Tensor, "height width 3"]]]:
    """The frames of a track with what was found drawn over all views, and their times."""
    rows = {int(frame): row for row, frame in enumerate(track.frame)}
    nothing = np.full(len(track), np.nan)
    overlaps = np.stack([track.measures.get(f"overlap_{name}", nothing) for name in recording.camera_names], -1)
    with recording.opened(0) as frames:
        for frame in frames:
            row = rows.get(frame.index)
            if row is None:
                continue
            pose = track.pose[row]
            picture = overlay(
                [view.image for view in frame.views],
                torch.tensor(pose, dtype=torch.float64) if np.isfinite(pose).all() else None,
                status=str(track.status[row]),
                frame=frame.index,
                overlaps=overlaps[row].tolist(),
                problems=frame.problems,
                undetermined=undetermined_fingers(None if track.finger_quality is None else track.finger_quality[row]),
            )
            yield frame.time_s, picture


def write_views(
    path: Path,
    track: Track,
    kinematics: HandKinematics,
    cameras: Sequence[Camera],
    shape: Float[Tensor, "shape"],
    recording: RigRecording,
) -> None:
    """The whole overlay video. cameras: in the track's unit, as they took the pictures."""
    overlay = ViewsOverlay(kinematics, cameras, shape)
    width, height = overlay.size
    with (
        write_video(path, width=width, height=height, fps=recording.fps) as video,
        tqdm(total=len(track), desc="overlay", unit="frame", disable=not sys.stderr.isatty()) as bar,
    ):
        first_s: float | None = None
        for time_s, picture in view_frames(track, overlay, recording):
            first_s = time_s if first_s is None else first_s
            video.write(picture, time_s=time_s - first_s)
            bar.update()
