"""Pose streams that grow while a hand is tracked: a pose a frame at the stream's rate, held ones marked, to the end."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.runs.streams.test_message import record
from torchhand.errors import InputError
from torchhand.export import PoseStreamReader, StreamSettings, clip_of_stream
from torchhand.files import FrameRecord, load_hand_model
from torchhand.hand import DOFS
from torchhand.runs.streams.pose_file import PoseRate, opened_pose_files
from torchhand.runs.streams.senders import check_streams

MODEL = load_hand_model()
SHAPE = MODEL.shape_space.default.double()
BOUND = np.array([0.55 * StreamSettings().step_of(dof) for dof in DOFS]) + 1e-12


def _unsaid(line: str) -> None:
    raise AssertionError(line)


def _frame(frame: int, time_s: float | None) -> FrameRecord:
    return replace(record(frame), time_s=time_s, pose=0.3 * record(frame).pose)


def _lost(frame: int, time_s: float) -> FrameRecord:
    return FrameRecord.empty(frame, "lost", dofs=len(DOFS), seconds=0.1, time_s=time_s)


def test_each_frame_can_be_read_before_the_next_is_taken(tmp_path: Path) -> None:
    path, reader = tmp_path / "a.thp", PoseStreamReader(MODEL)
    with (
        opened_pose_files(["jsonl", str(path)], PoseRate(25.0), "left", _unsaid) as [file],
        path.open("rb") as following,
    ):
        for number in range(3):  # no hand yet
            file.take(_lost(number, number / 25), SHAPE)
            assert len(reader.feed(following.read())[0]) == 0
        for number in range(3, 9):
            one = _frame(number, number / 25)
            file.take(one, SHAPE)
            poses, held = reader.feed(following.read())
            assert poses.shape == (1, 36)
            assert not held[0]
            assert (np.abs(poses[0].numpy() - one.pose) <= BOUND).all()
        assert not reader.has_ended
    clip = clip_of_stream(path, MODEL)
    assert (clip.frame, clip.side, clip.fps, clip.up, clip.notes) == (tuple(range(3, 9)), "left", 25.0, "-y", ())
    assert float((clip.shape - SHAPE).abs().max()) < 1e-8


def test_lost_and_dropped_frames_are_held_and_crowded_ones_left_out(tmp_path: Path) -> None:
    """At 10 frames a second: a lost one, two times that no frame has, and two frames for one time."""
    path = tmp_path / "a.thp"
    frames = [_frame(0, 5.0), _lost(1, 5.1), _frame(2, 5.41), _frame(3, 5.43), _frame(4, 5.48)]
    with opened_pose_files([str(path)], PoseRate(10.0), "right", _unsaid) as [file]:
        for frame in frames:
            file.take(frame, SHAPE)
    clip = clip_of_stream(path, MODEL)
    assert (clip.frame, clip.held) == ((0, 1, 2, 3, 4, 5), (1, 2, 3))
    assert torch.equal(clip.poses[1:4], clip.poses[:1].expand(3, -1))
    for place, own in ((0, frames[0]), (4, frames[2]), (5, frames[4])):
        assert (np.abs(clip.poses[place].numpy() - own.pose) <= BOUND).all()


def test_a_pause_is_held_for_so_long_at_most_and_told(tmp_path: Path) -> None:
    """An hour without pictures at 10 frames a second: two seconds of held poses, and the line that tells it; a gap of
    two seconds is as long as it was."""
    path, said = tmp_path / "a.thp", list[str]()
    frames = [_frame(0, 0.0), _frame(1, 2.0), _frame(2, 3602.0), _frame(3, 3602.1)]
    with opened_pose_files([str(path)], PoseRate(10.0, 2.0), "right", said.append) as [file]:
        for frame in frames:
            file.take(frame, SHAPE)
    clip = clip_of_stream(path, MODEL)
    assert clip.held == (*range(1, 20), *range(21, 40))
    for place, own in zip((0, 20, 40, 41), frames, strict=True):
        assert (np.abs(clip.poses[place].numpy() - own.pose) <= BOUND).all()
    [line] = said
    assert "3600.0 s without pictures before frame 2 last 2 s there (--max-gap-s)" in line
    assert line.endswith("what follows comes 3598.0 s early")


def test_files_that_cannot_be_made_are_refused(tmp_path: Path) -> None:
    there = tmp_path / "a.thp"
    there.write_bytes(b"kept")
    with pytest.raises(
        InputError, match=r"--stream: .*a\.thp: is there already: expected another name, or --overwrite"
    ):
        check_streams([str(there)])
    check_streams([str(there)], may_replace=True)
    assert there.read_bytes() == b"kept"
    with pytest.raises(InputError, match=r"expected a file in an existing folder, got none of .*nowhere"):
        check_streams([str(tmp_path / "nowhere" / "a.thp")])
    with (
        pytest.raises(InputError, match="cannot be written"),
        opened_pose_files([str(tmp_path / "nowhere" / "a.thp")], PoseRate(25.0), "left", _unsaid),
    ):
        pass


def test_without_a_hand_there_is_no_file_and_an_older_one_stays(tmp_path: Path) -> None:
    new, old = tmp_path / "new.thp", tmp_path / "old.thp"
    old.write_bytes(b"kept")
    said: list[str] = []
    with opened_pose_files([str(new), str(old)], PoseRate(25.0), "left", said.append) as files:
        for file in files:
            file.take(_lost(0, 0.0), SHAPE)
    assert not new.exists()
    assert old.read_bytes() == b"kept"
    assert said == [f"{old}: is the older stream, for there was no hand"]
    with opened_pose_files([str(old)], PoseRate(25.0), "left", _unsaid) as [file]:
        file.take(_frame(0, 0.0), SHAPE)
    assert len(clip_of_stream(old, MODEL)) == 1
