"""The video of `torchhand animate`: every pose drawn once, poses that are held reused."""

import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import torch
from tqdm import tqdm

from torchhand.draw import HandPainter, write_word
from torchhand.export import MotionClip
from torchhand.files import write_video
from torchhand.geometry import Camera, assumed_camera
from torchhand.signs import Spelling

_FOV_DEG = 30.0
_ROOM = 0.29  # metres; see `spelling_camera`
_UP = 0.012  # metres that the hand stands above the middle, for the word below
_AVERAGE_LENGTH = 0.187
_AT_ONCE = 64
_WORKERS = 2


def spelling_camera(width: int, height: int, hand_length: float, *, room: float = _ROOM) -> Camera:
    """A camera that sees a hand of that length which moves about the origin.

    room: what has to be seen around an average one, across and upwards, metres.
    """
    camera = assumed_camera(width, height, horizontal_fov_deg=_FOV_DEG)
    scale = hand_length / _AVERAGE_LENGTH
    focal = camera.intrinsics.diagonal()[:2].tolist()
    distance = max(scale * room * f / px for f, px in zip(focal, (width, height), strict=True))
    translation = torch.tensor((0.0, -_UP * scale, distance), dtype=camera.translation.dtype)
    return replace(camera, translation=translation)


def paint_spelling(path: Path, spelling: Spelling, clip: MotionClip, size: tuple[int, int]) -> None:
    """Write the video; two threads draw."""
    hand = clip.model.hand(clip.shape.float(), side=clip.side)
    length = float(clip.model.shape_space.metric(clip.shape)["hand_length"])
    painter = HandPainter(hand, spelling_camera(*size, length))
    poses = spelling.poses
    changes = torch.cat((torch.ones(1, dtype=torch.bool), (poses.diff(dim=0) != 0).any(-1)))
    shown = (changes.cumsum(0) - 1).tolist()
    distinct = poses[changes]
    bar = tqdm(total=len(poses), desc="drawing", unit="frame", disable=not sys.stderr.isatty())
    with (
        write_video(path, width=size[0], height=size[1], fps=clip.fps) as video,
        ThreadPoolExecutor(_WORKERS) as workers,
        bar,
    ):
        frame = 0
        for begin in range(0, len(distinct), _AT_ONCE):
            surfaces = painter.surfaces(distinct[begin : begin + _AT_ONCE])
            count = len(surfaces.vertices)
            drawn = workers.map(lambda i, of=surfaces: painter.paint(of.select(i)), range(count))
            for number, picture in enumerate(drawn, start=begin):
                while frame < len(poses) and shown[frame] == number:
                    lettered = picture.clone()
                    write_word(lettered, spelling.text, spelling.place[frame])
                    video.write(lettered)
                    frame += 1
                    bar.update()
