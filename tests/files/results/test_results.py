"""The result folder: complete, resumable bit for bit, and never worse than before."""

import errno
import json
import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from torchhand.errors import InputError
from torchhand.files.disk import LineFile
from torchhand.files.results.results import CHECKPOINT_NAME, UNFINISHED_NAME, TrackWriter, check_output_folder
from torchhand.files.results.track_file import load_track
from torchhand.files.results.track_record import FrameRecord, TrackHeader

DOFS = tuple(f"dof{i}" for i in range(36))


def _header(**changes: Any) -> TrackHeader:
    fields: dict[str, Any] = {"source": "wave.mp4", "side": "right", "camera": {"name": "cam0", "width": 640}}
    return TrackHeader(dof_names=DOFS, **{**fields, **changes})


class _Tracker:
    """Stands for the real one: every estimate depends on a generator and on all that came before."""

    def __init__(self, state: Mapping[str, Any] | None = None) -> None:
        self.generator = torch.Generator().manual_seed(3)
        self.mean = torch.zeros(36, dtype=torch.float64)
        if state is not None:
            self.generator.set_state(state["generator"])
            self.mean = state["mean"]

    def state(self) -> dict[str, Any]:
        return {"generator": self.generator.get_state(), "mean": self.mean, "name": "contour", "nested": {"lost": 0}}

    def step(self, frame: int) -> FrameRecord:
        self.mean = 0.9 * self.mean + torch.randn(36, generator=self.generator, dtype=torch.float64)
        if frame % 7 == 5:
            return FrameRecord.empty(frame, "lost", dofs=36, seconds=0.25)
        points = self.mean[:21, None].expand(21, 3).numpy()
        return FrameRecord(
            frame=frame,
            status="tracked",
            pose=self.mean.numpy(),
            pose_std=self.mean.abs().numpy(),
            keypoints3d=points,
            keypoints2d=points[:, :2] * 100,
            keypoints3d_cov=points[..., None] * points[:, None],
            seconds=0.01 * frame,
        )


class _Stop(BaseException):
    """Ctrl-C, without upsetting the test runner."""


def _run(folder: Path, last: int, *, stop_after: int | None = None, every: int = 5, **options: Any) -> TrackWriter:
    """Track frames 2 ... last as a command would."""
    with TrackWriter(folder, _header(), checkpoint_every=every, **options) as writer:
        point = writer.resume_point
        tracker = _Tracker(point.state if point else None)
        for frame in range(point.last_frame + 1 if point else 2, last + 1):
            writer.append(tracker.step(frame), tracker.state)
            if frame == stop_after:
                raise _Stop
    return writer


def _files(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def _content(folder: Path) -> dict[str, Any]:
    return {name: array.tolist() for name, array in load_track(folder).arrays().items() if name != "header"}


def test_a_finished_run(tmp_path: Path):
    _run(tmp_path / "out", 12)
    assert _files(tmp_path / "out") == ["header.json", "track.jsonl", "track.npz"]
    with np.load(tmp_path / "out" / "track.npz", allow_pickle=False) as stored:
        arrays = dict(stored)
    shapes = {name: array.shape for name, array in arrays.items() if array.ndim}
    assert shapes == {
        "frame": (11,),
        "status": (11,),
        "pose": (11, 36),
        "pose_std": (11, 36),
        "keypoints3d": (11, 21, 3),
        "keypoints2d": (11, 21, 2),
        "keypoints3d_cov": (11, 21, 3, 3),
        "seconds": (11,),
        "dof_names": (36,),
    }
    assert arrays["frame"].tolist() == list(range(2, 13))
    assert arrays["status"].tolist() == ["tracked"] * 3 + ["lost"] + ["tracked"] * 6 + ["lost"]
    tracker = _Tracker()
    for i in range(11):
        record = tracker.step(i + 2)
        np.testing.assert_array_equal(arrays["pose"][i], record.pose)
        np.testing.assert_array_equal(arrays["keypoints3d_cov"][i], record.keypoints3d_cov)
    assert np.isnan(arrays["pose"][3]).all()
    assert np.isnan(arrays["keypoints2d"][3]).all()
    assert str(arrays["units"]).startswith("metres, radians, seconds")
    assert "x right, y down, z forward" in str(arrays["convention"])


def test_the_lines_are_strict_json_and_there_at_once(tmp_path: Path):
    def refuse_constant(name: str) -> None:
        raise AssertionError(f"{name} is no JSON")

    with TrackWriter(tmp_path / "out", _header()) as writer:
        tracker = _Tracker()
        for frame in range(6):
            writer.append(tracker.step(frame))
            lines = (tmp_path / "out" / "track.jsonl").read_text().splitlines()
            assert len(lines) == frame + 1
    rows = [json.loads(line, parse_constant=refuse_constant) for line in lines]
    header = json.loads((tmp_path / "out" / "header.json").read_text(), parse_constant=refuse_constant)
    assert header["dof_names"] == list(DOFS)
    assert {"format", "units", "convention", "source", "camera", "side"} <= header.keys()
    assert [row["frame"] for row in rows] == list(range(6))
    assert rows[5]["status"] == "lost"
    assert rows[5]["keypoints2d"] == [[None, None]] * 21
    assert load_track(tmp_path / "out").header == header


def test_lines_and_arrays_read_alike(tmp_path: Path):
    _run(tmp_path / "out", 12)
    whole = _content(tmp_path / "out")
    (tmp_path / "out" / "track.npz").unlink()
    np.testing.assert_equal(_content(tmp_path / "out"), whole)


def test_several_cameras_have_no_2d_keypoints(tmp_path: Path):
    with TrackWriter(tmp_path / "out", _header()) as writer:
        writer.append(FrameRecord.empty(0, "no_hand", dofs=36, seconds=0.0, has_keypoints2d=False))
    for name in ("track.npz", "track.jsonl"):
        track = load_track(tmp_path / "out" / name)
        assert track.keypoints2d is None
        assert np.isnan(track.keypoints3d).all()


@pytest.mark.parametrize("stop_after", [2, 4, 5, 6, 7, 11, 12, 23])
def test_a_resumed_run_equals_an_uninterrupted_one(tmp_path: Path, stop_after: int):
    _run(tmp_path / "whole", 24)
    with pytest.raises(_Stop):
        _run(tmp_path / "broken", 24, stop_after=stop_after)
    assert len(load_track(tmp_path / "broken")) == stop_after - 1  # all that was tracked is readable
    _run(tmp_path / "broken", 24, resume=True)
    for name in ("track.jsonl", "track.npz"):
        assert (tmp_path / "broken" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes(), name


def test_a_finished_run_that_has_kept_its_checkpoint_can_go_on_further(tmp_path: Path):
    _run(tmp_path / "whole", 24)
    _run(tmp_path / "short", 12, keep_checkpoint=True)
    assert _files(tmp_path / "short") == [CHECKPOINT_NAME, "header.json", "track.jsonl", "track.npz"]
    assert _run(tmp_path / "short", 12, resume=True, keep_checkpoint=True).resume_point is not None
    assert len(load_track(tmp_path / "short")) == 11
    _run(tmp_path / "short", 24, resume=True)
    assert (tmp_path / "short" / "track.jsonl").read_bytes() == (tmp_path / "whole" / "track.jsonl").read_bytes()
    assert _files(tmp_path / "short") == _files(tmp_path / "whole")


@pytest.mark.parametrize("ends", [(None, None), (None, 40), (40, None), (40, 50), (13, 13)])
def test_a_finished_run_has_nothing_left_to_do(tmp_path: Path, ends: tuple[int | None, int | None]):
    """Whether it ended because its input did, or with the last frame that was wanted."""
    _run(tmp_path, 12, end=ends[0])
    before = {name: (tmp_path / name).read_bytes() for name in _files(tmp_path)}
    with TrackWriter(tmp_path, _header(), resume=True, end=ends[1]) as writer:
        assert writer.is_finished
        assert writer.resume_point is None
    assert {name: (tmp_path / name).read_bytes() for name in _files(tmp_path)} == before


@pytest.mark.parametrize("end", [None, 20])
def test_more_frames_than_a_finished_run_was_asked_for_are_refused(tmp_path: Path, end: int | None):
    _run(tmp_path, 12, end=13)
    before = {name: (tmp_path / name).read_bytes() for name in _files(tmp_path)}
    with pytest.raises(InputError, match=r"is finished with frame 12, .*\(--keep-checkpoint\); give --overwrite"):
        _run(tmp_path, 24, resume=True, end=end)
    assert {name: (tmp_path / name).read_bytes() for name in _files(tmp_path)} == before


def test_lines_that_were_lost_since_the_run_has_ended_are_tracked_again(tmp_path: Path):
    _run(tmp_path / "whole", 12)
    _run(tmp_path / "broken", 12)
    lines = tmp_path / "broken" / "track.jsonl"
    lines.write_bytes(b"".join(lines.read_bytes().splitlines(keepends=True)[:6]))
    writer = _run(tmp_path / "broken", 12, resume=True)
    assert not writer.is_finished
    assert "tracking from the first frame" in str(writer.note)
    assert lines.read_bytes() == (tmp_path / "whole" / "track.jsonl").read_bytes()


def test_a_replacement_that_was_killed_before_its_first_move_is_finished(tmp_path: Path):
    out = tmp_path / "out"
    _run(out, 12)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("torchhand.files.results.results.replace_result", lambda *_: (_ for _ in ()).throw(_Stop()))
        with pytest.raises(_Stop):
            _run(out, 20, overwrite=True)
    assert len(load_track(out)) == 11
    with TrackWriter(out, _header(), resume=True) as writer:
        assert writer.is_finished
    assert len(load_track(out)) == 19
    assert _files(out) == ["header.json", "track.jsonl", "track.npz"]


@pytest.mark.parametrize(
    "damage", ["half a line", "no checkpoint", "bad checkpoint", "lines lost", "half the first line", "npz"]
)
def test_resuming_after_a_crash(tmp_path: Path, damage: str):
    _run(tmp_path / "whole", 24)
    with pytest.raises(_Stop):
        _run(tmp_path / "broken", 24, stop_after=14)
    lines, checkpoint = tmp_path / "broken" / "track.jsonl", tmp_path / "broken" / CHECKPOINT_NAME
    if damage == "half a line":
        lines.write_bytes(lines.read_bytes()[:-300])
        assert len(load_track(lines)) == 12
    elif damage == "no checkpoint":
        checkpoint.unlink()
    elif damage == "bad checkpoint":
        checkpoint.write_bytes(checkpoint.read_bytes()[:700])
    elif damage == "lines lost":
        lines.write_bytes(b"".join(lines.read_bytes().splitlines(keepends=True)[:5]))
    elif damage == "half the first line":
        lines.write_bytes(lines.read_bytes()[:50])
    (tmp_path / "broken" / "track.npz").unlink()
    _run(tmp_path / "broken", 24, resume=True)
    for name in ("track.jsonl", "track.npz"):
        assert (tmp_path / "broken" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes(), name


def _run_with_corrections(folder: Path, *, stop_after: int | None = None, **options: Any) -> TrackWriter:
    """Every fifth frame corrects the three before it."""
    with TrackWriter(folder, _header(), checkpoint_every=4, **options) as writer:
        point = writer.resume_point
        tracker = _Tracker(point.state if point else None)
        for frame in range(point.last_frame + 1 if point else 0, 21):
            record = tracker.step(frame)
            if frame % 5 == 0 and frame:
                for back in (1, 2, 3):
                    writer.correct(replace(record, frame=frame - back, status="tracked", seconds=100.0 + back))
            writer.append(record, tracker.state)
            if frame == stop_after:
                raise _Stop
    return writer


def test_corrected_frames_take_the_place_of_the_first_ones(tmp_path: Path):
    _run_with_corrections(tmp_path)
    lines = [json.loads(line) for line in (tmp_path / "track.jsonl").read_text().splitlines()]
    assert [line["frame"] for line in lines] == list(range(21))
    track = load_track(tmp_path)
    assert track.frame.tolist() == list(range(21))
    assert track.seconds[17:20].tolist() == [103.0, 102.0, 101.0]
    assert track.seconds[16] < 100
    np.testing.assert_array_equal(track.pose[17], track.pose[20])


@pytest.mark.parametrize("stop_after", [3, 5, 7, 10, 11, 15, 19])
def test_a_resumed_run_with_corrections_equals_an_uninterrupted_one(tmp_path: Path, stop_after: int):
    _run_with_corrections(tmp_path / "whole")
    with pytest.raises(_Stop):
        _run_with_corrections(tmp_path / "broken", stop_after=stop_after)
    stopped = load_track(tmp_path / "broken")
    assert stopped.frame.tolist() == list(range(stop_after + 1))
    _run_with_corrections(tmp_path / "broken", resume=True)
    for name in ("track.jsonl", "track.npz"):
        assert (tmp_path / "broken" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes(), name


def test_only_earlier_frames_are_corrected(tmp_path: Path):
    with TrackWriter(tmp_path, _header()) as writer:
        writer.append(_Tracker().step(3))
        with pytest.raises(ValueError, match="frame: expected at most 3, got 4"):
            writer.correct(_Tracker().step(4))


def test_resuming_where_nothing_is_yet_starts(tmp_path: Path):
    assert _run(tmp_path / "out", 12, resume=True).resume_point is None
    assert len(load_track(tmp_path / "out")) == 11


def test_resuming_with_other_options_is_refused(tmp_path: Path):
    _run(tmp_path / "out", 12)
    before = (tmp_path / "out" / "track.jsonl").read_bytes()
    for change, message in (
        ({"side": "left"}, "cannot be resumed: side was 'right', is now 'left'"),
        ({"camera": {"name": "cam0", "width": 320}}, r"camera.width was 640, is now 320"),
        ({"made_with": {"seed": 1}}, r"made_with.seed was None, is now 1"),
    ):
        with pytest.raises(InputError, match=message):
            TrackWriter(tmp_path / "out", _header(**change), resume=True)
    assert (tmp_path / "out" / "track.jsonl").read_bytes() == before


def test_resuming_in_a_foreign_folder_is_refused(tmp_path: Path):
    (tmp_path / "letter.txt").write_text("dear")
    with pytest.raises(InputError, match=r"cannot be resumed: expected track.jsonl, found letter.txt"):
        TrackWriter(tmp_path, _header(), resume=True)
    (tmp_path / "track.jsonl").write_text('{"other": 1}\n')
    with pytest.raises(InputError, match=r"track.jsonl: expected a track"):
        TrackWriter(tmp_path, _header(), resume=True)
    (tmp_path / "track.jsonl").write_text('{"format": "torchhand track 1"}\n{"frame": 0}\n')
    with pytest.raises(InputError, match=r"track.jsonl: was written by an earlier version"):
        TrackWriter(tmp_path, _header(), resume=True)
    assert _files(tmp_path) == ["letter.txt", "track.jsonl"]


def test_a_folder_with_content_is_refused(tmp_path: Path):
    _run(tmp_path / "out", 12)
    before = {name: (tmp_path / "out" / name).read_bytes() for name in _files(tmp_path / "out")}
    with pytest.raises(InputError, match=r"out: the output folder exists and is not empty \(header.json, .*--resume"):
        _run(tmp_path / "out", 3)
    with pytest.raises(InputError, match="at most one of --resume and --overwrite"):
        _run(tmp_path / "out", 3, resume=True, overwrite=True)
    assert {name: (tmp_path / "out" / name).read_bytes() for name in _files(tmp_path / "out")} == before
    (tmp_path / "empty").mkdir()
    check_output_folder(tmp_path / "empty")
    check_output_folder(tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_overwriting_replaces_everything_at_the_end(tmp_path: Path):
    out = tmp_path / "out"
    writer = _run(out, 12)
    (writer.folder / "overlay.mp4").write_text("old film")
    (writer.folder / "hand.json").write_text("old hand")
    (out / "notes.txt").write_text("the user's own")
    old = load_track(out).pose
    with TrackWriter(out, _header(side="left"), overwrite=True) as writer:
        (writer.folder / "hand.json").write_text("new hand")
        writer.append(_Tracker().step(0))
        np.testing.assert_array_equal(load_track(out).pose, old)
        assert len(load_track(writer.folder)) == 1  # the overlay is drawn from this
    assert load_track(out).frame.tolist() == [0]
    assert load_track(out).header["side"] == "left"
    assert (out / "hand.json").read_text() == "new hand"
    assert _files(out) == ["hand.json", "header.json", "notes.txt", "track.jsonl", "track.npz"]


@pytest.mark.parametrize("frames", [0, 3])
def test_overwriting_that_is_interrupted_keeps_the_old_result(tmp_path: Path, frames: int):
    out = tmp_path / "out"
    _run(out, 12)
    before = {name: (out / name).read_bytes() for name in _files(out)}

    def interrupted() -> None:
        with TrackWriter(out, _header(), overwrite=True) as writer:
            for frame in range(frames):
                writer.append(_Tracker().step(frame))
            raise _Stop

    with pytest.raises(_Stop):
        interrupted()
    assert {name: (out / name).read_bytes() for name in _files(out) if name != UNFINISHED_NAME} == before
    assert len(load_track(out / UNFINISHED_NAME)) == frames
    _run(out, 24, resume=True)  # goes on with what was interrupted
    assert load_track(out).frame.tolist() == list(range(2, 25))
    assert UNFINISHED_NAME not in _files(out)


def test_an_error_before_the_first_frame_leaves_everything_as_it_was(tmp_path: Path):
    def failing(folder: Path, **options: Any) -> None:
        with TrackWriter(folder, _header(), **options) as writer:
            (writer.folder / "config.yaml").write_text("settings")
            raise InputError("no such port")

    old, own = tmp_path / "old", tmp_path / "own"
    _run(old, 12)
    own.mkdir()
    (own / "notes.txt").write_text("the user's own")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    for folder, options in (
        (tmp_path / "new" / "deep", {}),
        (tmp_path / "new", {"resume": True}),
        (own, {"overwrite": True}),
        (old, {"overwrite": True}),
    ):
        with pytest.raises(InputError, match="no such port"):
            failing(folder, **options)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["old", "own"]
    assert UNFINISHED_NAME not in _files(old)


def test_an_error_before_the_first_frame_keeps_an_interrupted_attempt(tmp_path: Path):
    out = tmp_path / "out"
    _run(out, 12)
    with pytest.raises(_Stop):
        _run(out, 20, stop_after=9, overwrite=True)
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}

    def failing() -> None:
        with TrackWriter(out, _header(), overwrite=True) as writer:
            (writer.folder / "config.yaml").write_text("settings")
            raise InputError("no such port")

    for _ in range(2):
        with pytest.raises(InputError, match="no such port"):
            failing()
        assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before
    _run(out, 20, resume=True)
    assert load_track(out).frame.tolist() == list(range(2, 21))
    assert UNFINISHED_NAME not in _files(out)


def test_overwriting_with_nothing_keeps_the_old_result(tmp_path: Path):
    _run(tmp_path / "out", 12)
    with TrackWriter(tmp_path / "out", _header(), overwrite=True):
        pass
    assert len(load_track(tmp_path / "out")) == 11


def test_an_old_interrupted_attempt_does_not_leak_into_a_new_one(tmp_path: Path):
    out = tmp_path / "out"
    _run(out, 12)

    def interrupted() -> None:
        with TrackWriter(out, _header(), overwrite=True) as writer:
            (writer.folder / "overlay.mp4").write_text("half a film")
            writer.append(_Tracker().step(0))
            raise _Stop

    with pytest.raises(_Stop):
        interrupted()
    _run(out, 20, overwrite=True)
    assert _files(out) == ["header.json", "track.jsonl", "track.npz"]
    assert len(load_track(out)) == 19


class _FullDisk:
    """A raw file that takes `room` more bytes and then says that the disk is full."""

    def __init__(self, file: Any, room: int) -> None:
        self.file, self.room = file, room

    def write(self, data: bytes) -> int:
        if not self.room:
            raise OSError(errno.ENOSPC, "No space left on device")
        written = self.file.write(data[: self.room])
        self.room -= written
        return written

    def __getattr__(self, name: str) -> Any:
        return getattr(self.file, name)


def test_a_full_disk_keeps_the_whole_lines(tmp_path: Path):
    tracker = _Tracker()

    def run() -> None:
        with TrackWriter(tmp_path / "out", _header()) as writer:
            writer.append(tracker.step(0))
            writer._lines._file = _FullDisk(writer._lines._file, 500)  # pyright: ignore[reportAttributeAccessIssue]
            writer.append(tracker.step(1))

    with pytest.raises(InputError, match=r"track.jsonl: cannot be written \(no space left on the disk\)"):
        run()
    assert (tmp_path / "out" / "track.jsonl").read_bytes().endswith(b"}\n")
    assert load_track(tmp_path / "out").frame.tolist() == [0]


def test_a_full_disk_at_the_end_keeps_lines_and_the_old_arrays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    _run(tmp_path / "out", 12)
    before = (tmp_path / "out" / "track.npz").read_bytes()

    def full(file: Any, **_: Any) -> None:
        file.write(b"PK")
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(np, "savez", full)
        with pytest.raises(InputError, match=r"track.npz: cannot be written \(no space left on the disk\)"):
            _run(tmp_path / "out", 24, resume=True)
    assert (tmp_path / "out" / "track.npz").read_bytes() == before
    assert _files(tmp_path / "out") == [CHECKPOINT_NAME, "header.json", "track.jsonl", "track.npz"]
    assert load_track(tmp_path / "out").frame.tolist() == list(range(2, 25))  # the lines hold more


def test_places_that_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="file: expected a folder for the results, got a file"):
        TrackWriter(tmp_path / "file", _header())
    with pytest.raises(InputError, match=r"out: cannot be written \(a part of the path is a file"):
        TrackWriter(tmp_path / "file" / "out", _header())

    def refuse(*_: Any, **__: Any) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "mkdir", refuse)
        with pytest.raises(InputError, match=r"out: cannot be written \(no permission to write\)"):
            TrackWriter(tmp_path / "out", _header())
    with monkeypatch.context() as patch:
        patch.setattr("builtins.open", refuse)
        with pytest.raises(InputError, match=r"track.jsonl: cannot be written \(no permission to write\)"):
            TrackWriter(tmp_path / "out", _header())
    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", refuse)
        with pytest.raises(InputError, match=r"header.json: cannot be written \(no permission to write\)"):
            _run(tmp_path / "early", 3)
    assert _files(tmp_path / "early") == []
    with TrackWriter(tmp_path / "other", _header()) as writer, monkeypatch.context() as patch:
        tracker = _Tracker()
        writer.append(tracker.step(0), tracker.state)
        patch.setattr(os, "replace", refuse)
        with pytest.raises(InputError, match=r"checkpoint.pt: cannot be written \(no permission to write\)"):
            writer.keep_forward()
    assert len(load_track(tmp_path / "other")) == 1


def test_a_killed_process_leaves_a_readable_track(tmp_path: Path):
    """SIGKILL in the middle: no handler runs, the lines are there."""
    code = f"""
import os, signal, sys
sys.path.insert(0, {str(Path(__file__).parents[3])!r})
from pathlib import Path
from torchhand.files import FrameRecord, TrackHeader, TrackWriter
header = TrackHeader(dof_names=("a", "b"), source="x", side="left", camera={{}})
with TrackWriter(Path({str(tmp_path / "out")!r}), header) as writer:
    for frame in range(5):
        writer.append(FrameRecord.empty(frame, "no_hand", dofs=2, seconds=0.5))
    os.kill(os.getpid(), signal.SIGKILL)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == -signal.SIGKILL, done.stderr
    assert _files(tmp_path / "out") == ["header.json", "track.jsonl"]
    assert load_track(tmp_path / "out").seconds.tolist() == [0.5] * 5


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("track.npz", b"PK no archive", "track.npz: is no track that can be read"),
        (
            "track.jsonl",
            b'{"format": "torchhand track 1", "dof_names": ["a"]}\n{"frame": 0}\n',
            "track.jsonl: was written by an earlier version, whose first line is a header",
        ),
        ("track.jsonl", b"", "track.jsonl: expected a track, whose header.json is beside it, found none"),
        ("track.jsonl", b'{"frame": 0}\n', "track.jsonl: expected a track, whose header.json"),
    ],
)
def test_files_that_are_no_track(tmp_path: Path, name: str, content: bytes, message: str):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=message):
        load_track(tmp_path)


def test_lines_under_another_header(tmp_path: Path):
    _run(tmp_path / "out", 12)
    header = tmp_path / "out" / "header.json"
    for content, message in (
        ('{"format": "recipe"}', r"header.json: expected the header of a track"),
        ('["format"]', r"header.json: expected the header of a track"),
        ('{"format": ', r"header.json, line 1: is no valid JSON"),
        ('{"format": "torchhand track 2", "dof_names": ["a"]}', r"track.jsonl: is no track that can be read"),
    ):
        header.write_text(content)
        with pytest.raises(InputError, match=message):
            load_track(tmp_path / "out" / "track.jsonl")


def test_the_result_of_an_earlier_version_is_refused(tmp_path: Path):
    """Its arrays are still read by their own name."""
    _run(tmp_path, 12)
    lines, header = tmp_path / "track.jsonl", tmp_path / "header.json"
    old = json.loads(header.read_text()) | {"format": "torchhand track 1"}
    lines.write_text(json.dumps(old) + "\n" + lines.read_text())
    header.unlink()
    with pytest.raises(InputError, match=r"track.jsonl: was written by an earlier version"):
        load_track(tmp_path)
    assert len(load_track(tmp_path / "track.npz")) == 11


def test_a_folder_without_a_track(tmp_path: Path):
    with pytest.raises(
        InputError, match=r"expected a folder with track.npz, track.jsonl, poses.npz or keypoints_fit.npz, found none"
    ):
        load_track(tmp_path)
    with pytest.raises(InputError, match=r"gone.npz: cannot be read"):
        load_track(tmp_path / "gone.npz")


def test_records_are_checked(tmp_path: Path):
    good = _Tracker().step(0)
    fields = {name: getattr(good, name) for name in good.__dataclass_fields__}
    with pytest.raises(ValueError, match=r"pose, pose_std, .*: expected NaN in a frame that is lost, got numbers"):
        FrameRecord(**{**fields, "status": "lost"})
    with TrackWriter(tmp_path / "out", _header()) as writer:
        writer.append(good)
        with pytest.raises(ValueError, match="frame: expected more than 0, got 0"):
            writer.append(good)
        with pytest.raises(ValueError, match="pose: expected 36 DOFs, got 2"):
            writer.append(FrameRecord.empty(1, "lost", dofs=2, seconds=0.0))
    with pytest.raises(ValueError, match="checkpoint_every: expected 1 or more frames, got 0"):
        TrackWriter(tmp_path / "other", _header(), checkpoint_every=0)


def test_a_line_file_cuts_off_what_comes_after_its_size(tmp_path: Path):
    path = tmp_path / "lines"
    path.write_text("one\ntwo\nthr")
    lines = LineFile(path, size=4)
    lines.append("zwei")
    lines.sync()
    lines.close()
    assert path.read_text() == "one\nzwei\n"


def test_qualities_of_fingers_are_kept_where_there_are_some(tmp_path: Path):
    """In both files; lost frames hold NaN, and a track of which nobody told them has none."""
    quality = np.array((0.9, 0.1, 1.0, 0.25, 1e-9))
    with TrackWriter(tmp_path / "out", _header(), checkpoint_every=5) as writer:
        tracker = _Tracker()
        for frame in range(2, 7):
            record = tracker.step(frame)
            if record.status == "tracked":
                record = replace(record, finger_quality=quality, measures={"quality": 0.5})
            writer.append(record, tracker.state)
    for name in ("track.npz", "track.jsonl"):
        track = load_track(tmp_path / "out" / name)
        assert track.finger_quality is not None
        assert np.isnan(track.finger_quality[3]).all()
        np.testing.assert_array_equal(track.finger_quality[[0, 1, 2, 4]], np.tile(quality, (4, 1)))
        assert track.measures["quality"][0] == 0.5
    _run(tmp_path / "old", 6)
    assert load_track(tmp_path / "old").finger_quality is None


def test_a_lost_frame_has_no_qualities():
    with pytest.raises(ValueError, match="finger_quality: expected NaN"):
        replace(FrameRecord.empty(0, "lost", dofs=36, seconds=0.0), finger_quality=np.ones(5))


def test_a_damaged_checkpoint_is_told_and_the_run_begins_anew(tmp_path: Path):
    _run(tmp_path / "whole", 24)
    with pytest.raises(_Stop):
        _run(tmp_path / "broken", 24, stop_after=14)
    checkpoint = tmp_path / "broken" / CHECKPOINT_NAME
    data = bytearray(checkpoint.read_bytes())
    data[-200] ^= 1  # one bit of a number
    checkpoint.write_bytes(data)
    writer = _run(tmp_path / "broken", 24, resume=True)
    assert str(writer.note).endswith(
        "checkpoint.pt: is damaged, or no checkpoint of this version; tracking from the first frame"
    )
    assert (tmp_path / "broken" / "track.npz").read_bytes() == (tmp_path / "whole" / "track.npz").read_bytes()


def test_fewer_frames_than_are_done_cannot_be_resumed(tmp_path: Path):
    _run(tmp_path, 24)
    before = {entry.name: entry.read_bytes() for entry in tmp_path.iterdir()}
    with pytest.raises(
        InputError, match=r"frame 24 is done, and the last one that is wanted is 11; give a larger --max"
    ):
        _run(tmp_path, 24, resume=True, end=12)
    assert {entry.name: entry.read_bytes() for entry in tmp_path.iterdir()} == before


@pytest.mark.parametrize("moves", range(7))
def test_a_result_is_replaced_as_one_step(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moves: int):
    """Killed after any number of moved files, the folder holds the old result or the new one, never some of both."""

    def replaced(folder: Path, name: str, **options: Any) -> None:
        with TrackWriter(folder, _header(source=name), **options) as writer:
            tracker = _Tracker()
            writer.append(tracker.step(2), tracker.state)
            (writer.folder / "hand.json").write_text(name)
            if name == "old":
                (writer.folder / "overlay.mp4").write_text("of the old one alone")

    replaced(tmp_path, "old")
    left = [moves]
    replace_file = os.replace

    def killed(source: Path, target: Path) -> None:
        if Path(source).parent.name == UNFINISHED_NAME and Path(target).parent == tmp_path:
            if not left[0]:
                raise _Stop
            left[0] -= 1
        replace_file(source, target)

    with monkeypatch.context() as patched:
        patched.setattr(os, "replace", killed)
        try:
            replaced(tmp_path, "new", overwrite=True)
        except _Stop:
            assert moves < 5
    assert load_track(tmp_path).header["source"] == "new"  # whoever reads it first finishes the moves
    assert (tmp_path / "hand.json").read_text() == "new"
    assert {entry.name for entry in tmp_path.iterdir()} == {*("hand.json", "header.json", "track.npz", "track.jsonl")}


def _damaged_header(arrays: dict[str, Any]) -> None:
    arrays["header"] = np.array("[1]")


def _short_status(arrays: dict[str, Any]) -> None:
    arrays["status"] = arrays["status"][:-1]


def _narrow_pose(arrays: dict[str, Any]) -> None:
    arrays["pose"] = arrays["pose"][:, :5]


def _wrong_names(arrays: dict[str, Any]) -> None:
    arrays["dof_names"] = np.arange(36)


def _numeric_status(arrays: dict[str, Any]) -> None:
    arrays["status"] = np.zeros(len(arrays["frame"]))


@pytest.mark.parametrize("damage", [_damaged_header, _short_status, _narrow_pose, _wrong_names, _numeric_status])
def test_damaged_arrays_of_a_track(tmp_path: Path, damage: Any):
    _run(tmp_path, 12)
    with np.load(tmp_path / "track.npz") as stored:
        arrays = dict(stored)
    damage(arrays)
    np.savez(tmp_path / "other.npz", **arrays)
    with pytest.raises(
        InputError, match=r"other.npz: is no track that can be read \(ValueError: (header|status|pose|dof_names): "
    ):
        load_track(tmp_path / "other.npz")


@pytest.mark.parametrize("line", ['"frame":' + "1" * 50, '"frame":null', '"frame":7.5', '"frame":[1]'])
def test_damaged_lines_of_a_track(tmp_path: Path, line: str):
    _run(tmp_path, 12)
    path = tmp_path / "track.jsonl"
    path.write_text(path.read_text().replace('"frame":7', line))
    with pytest.raises(InputError, match=r"track.jsonl: is no track that can be read"):
        load_track(path)


def test_arrays_of_32_bits_are_a_track_too(tmp_path: Path):
    _run(tmp_path, 12)
    with np.load(tmp_path / "track.npz") as stored:
        arrays = dict(stored)
    np.savez(tmp_path / "track.npz", **arrays | {"pose": arrays["pose"].astype(np.float32)})
    track = load_track(tmp_path)
    assert track.pose.dtype == np.float64
    np.testing.assert_allclose(track.pose, arrays["pose"], rtol=1e-6)


@pytest.mark.parametrize("line", ['{"frame": [3]}', '{"frame": null}', '{"fram": 3}'])
def test_a_damaged_line_before_the_checkpoint_is_told_and_the_run_begins_anew(tmp_path: Path, line: str):
    _run(tmp_path / "whole", 24)
    with pytest.raises(_Stop):
        _run(tmp_path / "broken", 24, stop_after=14)
    lines = tmp_path / "broken" / "track.jsonl"
    content = lines.read_text().splitlines()
    lines.write_text("\n".join([*content[:3], line, *content[3:]]) + "\n")
    writer = _run(tmp_path / "broken", 24, resume=True)
    assert str(writer.note).endswith("track.jsonl, line 4: is damaged; tracking from the first frame")
    for name in ("track.jsonl", "track.npz"):
        assert (tmp_path / "broken" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes(), name
