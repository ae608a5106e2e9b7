"""Videos of a folder: what a lost worker had begun is gone on with, and every video has its own report."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from torchhand.cluster import Cluster
from torchhand.errors import DiskError, InputError
from torchhand.files import FrameRecord, TrackHeader, TrackWriter, load_track
from torchhand.hand import DOFS
from torchhand.runs import Request, Video, settings_of, track_videos, videos, with_own_keypoints, without_hand
from torchhand.track import STILL_SEARCHED

REQUEST = Request(settings=settings_of("contour_planar"), config="contour_planar")


class Here(Cluster):
    """A cluster of this process alone."""

    def __init__(self) -> None:
        pass

    def done(self, make_work: Any, items: Any) -> Any:
        work = make_work()
        return ((item, work(item)) for item in items)


def _tracked(request: Request, items: list[Video]) -> dict[str, Any]:
    return {video.name: report for video, report in track_videos(Here(), request, items, 64.0)}


def test_each_video_has_its_report(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    asked: dict[str, bool] = {}

    def track(source: Path, out_dir: Path, request: Request, say: Any) -> Any:
        asked[source.name] = request.resume
        say("what it says")
        raise InputError(f"{source}: is none")

    monkeypatch.setattr(videos, "track_sequence", track)
    begun = Video(name="begun", source=tmp_path / "begun.mp4", out_dir=tmp_path / "begun")
    begun.out_dir.mkdir()
    (begun.out_dir / "track.jsonl").touch()
    new = Video(name="new", source=tmp_path / "new.mp4", out_dir=tmp_path / "new")
    reports = _tracked(REQUEST, [begun, new])
    assert asked == {"begun.mp4": True, "new.mp4": False}
    assert reports["new"].error == f"{tmp_path / 'new.mp4'}: is none"
    assert reports["new"].said == ("what it says",)
    assert _tracked(replace(REQUEST, overwrite=True), [begun])["begun"].error
    assert asked["begun.mp4"] is False


def test_warnings_of_a_video_are_in_its_report(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def track(*_: Any) -> Any:
        assert not sys.stderr.isatty()  # a bar is drawn on a terminal alone
        print("UserWarning: an old decoder", file=sys.stderr)
        raise InputError("none")

    monkeypatch.setattr(videos, "track_sequence", track)
    reports = _tracked(REQUEST, [Video(name="one", source=tmp_path / "one.mp4", out_dir=tmp_path / "one")])
    assert reports["one"].said == ("UserWarning: an old decoder",)


def test_a_full_disk_ends_all_of_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def track(*_: Any) -> Any:
        raise DiskError("no space")

    monkeypatch.setattr(videos, "track_sequence", track)
    with pytest.raises(DiskError, match="no space"):
        _tracked(REQUEST, [Video(name="one", source=tmp_path / "one.mp4", out_dir=tmp_path / "one")])


def _three_videos(folder: Path) -> list[Video]:
    return [Video(name=name, source=folder / f"{name}.mp4", out_dir=folder / "out" / name) for name in "abc"]


def test_each_video_has_its_own_keypoints(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    found = tmp_path / "found"
    (found / "b").mkdir(parents=True)
    (found / "c").mkdir()
    for name in ("a.npz", "b/keypoints.npz", "b.npz", "c/0.json"):
        (found / name).touch()
    asked: dict[str, tuple[Path, ...]] = {}

    def track(source: Path, out_dir: Path, request: Request, say: Any) -> Any:
        asked[source.stem] = request.keypoints
        raise InputError("none")

    monkeypatch.setattr(videos, "track_sequence", track)
    _tracked(REQUEST, with_own_keypoints(_three_videos(tmp_path), [found]))
    assert asked == {"a": (found / "a.npz",), "b": (found / "b" / "keypoints.npz",), "c": (found / "c",)}


def test_keypoints_that_are_not_of_each_video_are_refused(tmp_path: Path) -> None:
    items = _three_videos(tmp_path)
    assert with_own_keypoints(items, []) == items
    (tmp_path / "a.npz").touch()
    with pytest.raises(InputError, match=r"with keypoints of each video .*got a file for 3 videos"):
        with_own_keypoints(items, [tmp_path / "a.npz"])
    assert with_own_keypoints(items[:1], [tmp_path / "a.npz"]) == items[:1]  # the only one: the request's file is its
    with pytest.raises(InputError, match=r"NAME\.npz.* found none of b, c$"):
        with_own_keypoints(items, [tmp_path])
    for item in items:
        item.out_dir.mkdir(parents=True)
        (item.out_dir / "keypoints.npz").touch()
    with pytest.raises(InputError, match="another folder than that of --out"):
        with_own_keypoints(items, [tmp_path / "out"])


def test_why_no_hand_was_found_is_what_most_frames_tell_once_one_was_searched(tmp_path: Path) -> None:
    def told(*reasons: str) -> str | None:
        header = TrackHeader(dof_names=DOFS, source="", side="right", camera={})
        with TrackWriter(tmp_path / "out", header, overwrite=True) as writer:
            for frame, reason in enumerate(reasons):
                writer.append(FrameRecord.empty(frame, "no_hand", dofs=len(DOFS), seconds=0.1, reason=reason))
        return without_hand(load_track(tmp_path / "out"))

    assert told(STILL_SEARCHED, STILL_SEARCHED) == f"no hand was found: {STILL_SEARCHED}, which takes seconds"
    searched = told(STILL_SEARCHED, STILL_SEARCHED, STILL_SEARCHED, "a wall", "a face", "a face")
    assert searched == "no hand was found (a face); name its --posture, or give --start-points or --keypoints"
