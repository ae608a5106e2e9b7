"""Streams that are written frame by frame: the bytes of a stream written whole, and readers that follow the file."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from torchhand.export.clip import MotionClip
from torchhand.export.stream.channels import StreamSettings
from torchhand.export.stream.pose_stream import PoseStreamReader, clip_of_stream, encode_clip
from torchhand.export.stream.writer import PoseStreamWriter, StreamHead
from torchhand.files import load_hand_model
from torchhand.hand import DOFS
from torchhand.numerics import wander

MODEL = load_hand_model()
SHAPE = MODEL.shape_space.default.double()


def _poses(frames: int = 60) -> Tensor:
    curves = wander(torch.arange(frames, dtype=torch.float64) / 25, len(DOFS), torch.Generator().manual_seed(4))
    return torch.cat((0.1 * curves[:, :3], 3.0 * curves[:, 3:6], 0.4 * curves[:, 6:].abs()), -1)


def _head(**changes: object) -> StreamHead:
    return StreamHead(**({"model": MODEL, "side": "left", "shape": SHAPE, "fps": 25.0, "up": "z"} | changes))  # type: ignore[arg-type]


@pytest.mark.parametrize("packet_poses", [1, 7, 255])
def test_frame_by_frame_gives_the_bytes_of_the_whole(packet_poses: int) -> None:
    """Turns of more than half a turn, held poses and a rest that fills no packet included."""
    settings, poses, held = StreamSettings(packet_poses=packet_poses), _poses(), (20, 21, 59)
    clip = MotionClip(model=MODEL, side="left", shape=SHAPE, poses=poses, fps=25.0, held=held, name="hand", up="z")
    whole, _ = encode_clip(clip, settings)
    writer = PoseStreamWriter(_head(), settings)
    is_held = np.isin(np.arange(len(poses)), held)
    pieces = [writer.add(poses[i : i + 1], is_held[i : i + 1]) for i in range(len(poses))]
    assert writer.head + b"".join(pieces) + writer.end() == whole
    assert [bool(piece) for piece in pieces] == [(i + 1) % packet_poses == 0 for i in range(len(poses))]


def test_a_reader_follows_the_growing_file(tmp_path: Path) -> None:
    """Each pose can be read as soon as it is written, and no earlier; a writer that dies leaves a stream without an
    end, all of whose poses are read."""
    settings, poses, path = StreamSettings(packet_poses=1), _poses(30), tmp_path / "a.thp"
    writer, reader = PoseStreamWriter(_head(first=7), settings), PoseStreamReader(MODEL)
    bound = torch.tensor([settings.dead_zone * settings.step_of(dof) for dof in DOFS], dtype=torch.float64)
    with path.open("wb", buffering=0) as growing, path.open("rb") as following:
        growing.write(writer.head)
        assert len(reader.feed(following.read())[0]) == 0
        for i in range(len(poses)):
            growing.write(writer.add(poses[i : i + 1]))
            found, held = reader.feed(following.read())
            assert found.shape == (1, len(DOFS))
            assert not held[0]
            assert bool(((found - poses[i]).abs()[0, 6:] <= bound[6:] + 1e-12).all())
        so_far = clip_of_stream(path, MODEL)
        assert so_far.frame == tuple(range(7, 37))
        assert so_far.notes == ("the stream has no end yet: the 30 poses that are whole were read",)
        growing.write(writer.end())
        reader.feed(following.read())
    assert reader.has_ended
    assert clip_of_stream(path, MODEL).notes == ()


def test_what_does_not_move_costs_nothing_and_comes_back() -> None:
    poses = _poses(5)
    poses[:, 6:] = 0.2
    still = dict.fromkeys(DOFS[6:], 0.2)
    writer = PoseStreamWriter(_head(still=still, has_held=False))
    data = writer.head + writer.add(poses) + writer.end()
    back, held = PoseStreamReader(MODEL).feed(data)
    assert torch.equal(back[:, 6:], poses[:, 6:])
    assert not held.any()
    with pytest.raises(ValueError, match="is_held: expected none in a stream without held poses"):
        writer.add(poses[:1], np.array([True]))
    with pytest.raises(ValueError, match="values: expected finite numbers"):
        writer.add(poses[:1] * math.nan)
