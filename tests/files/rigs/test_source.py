"""Recordings of several cameras: synchronous frames, and a reason for every view that has no picture."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from torchhand.errors import InputError
from torchhand.files.rigs.faults import FROZEN_AFTER
from torchhand.files.rigs.source import RigFrame, RigSource, offsets_of, open_rig, open_uncalibrated
from torchhand.files.rigs.views import find_views, view_paths
from torchhand.geometry import Camera, assumed_camera

WIDTH, HEIGHT = 64, 48
Picture = Callable[..., np.ndarray]


def cameras(count: int = 3) -> list[Camera]:
    return [replace(assumed_camera(WIDTH, HEIGHT), name=f"cam{i}") for i in range(count)]


def number(image: torch.Tensor | None) -> int | None:
    """The number that a test picture shows."""
    if image is None:
        return None
    column = image[:, 48:].float().mean((1, 2))
    return sum(int(column[(2 * bit + 1) * HEIGHT // 12] > 120) << bit for bit in range(6))


def numbers(frames: list[RigFrame]) -> list[list[int | None]]:
    return [[number(image) for image in frame.images] for frame in frames]


@pytest.fixture
def record(tmp_path: Path, picture: Picture) -> Callable[..., Path]:
    """record(range(5), range(4)) writes these numbered pictures of view_0 and view_1."""

    def make(*views: range | list[int]) -> Path:
        for i, wanted in enumerate(views):
            (tmp_path / f"view_{i}").mkdir()
            for index in wanted:
                assert cv2.imwrite(str(tmp_path / f"view_{i}" / f"{index:04d}.png"), picture(index))
        return tmp_path

    return make


def read(source: RigSource) -> list[RigFrame]:
    with source:
        return list(source)


def test_frames_of_all_views(record: Callable[..., Path]) -> None:
    source = open_rig(record(range(5), range(5), range(5)), cameras())
    assert (source.names, source.count, source.warnings) == (("cam0", "cam1", "cam2"), 5, [])
    frames = read(source)
    assert [frame.index for frame in frames] == list(range(5))
    assert numbers(frames) == [[i, i, i] for i in range(5)]
    assert all(frame.problems == (None, None, None) for frame in frames)
    with pytest.raises(ValueError, match="read once"):
        next(iter(source))


def test_start_and_most_frames(record: Callable[..., Path]) -> None:
    folder = record(range(6), range(6))
    source = open_rig(folder, cameras(2), start=2, max_frames=3)
    assert source.count == 3
    frames = read(source)
    assert [frame.index for frame in frames] == [2, 3, 4]
    assert numbers(frames) == [[2, 2], [3, 3], [4, 4]]
    with pytest.raises(InputError, match=r"start 6 lies after the last frame \(5\)"):
        open_rig(folder, cameras(2), start=6)


def test_folders_and_videos_named_after_cameras(
    record: Callable[..., Path], make_video: Callable[..., Path], tmp_path: Path
) -> None:
    record(range(4))
    make_video("cam1.mp4", 4)
    (tmp_path / "view_0").rename(tmp_path / "cam0")
    assert numbers(read(open_rig(tmp_path, cameras(2)))) == [[i, i] for i in range(4)]


def test_videos_of_any_name_in_their_order(make_video: Callable[..., Path], tmp_path: Path) -> None:
    for name in ("take_2.mp4", "take_10.mp4"):
        make_video(name, 3)
    paths = view_paths(tmp_path, ["left", "right"])
    assert [path.name for path in paths if path] == ["take_2.mp4", "take_10.mp4"]
    assert len(read(open_rig(tmp_path, cameras(2)))) == 3


def test_views_of_different_length(record: Callable[..., Path]) -> None:
    source = open_rig(record(range(5), range(3)), cameras(2))
    assert source.warnings == ["the views differ in length (cam0 5, cam1 3 frames): reading ends with the shortest"]
    assert numbers(read(source)) == [[0, 0], [1, 1], [2, 2]]


def test_videos_of_different_length(make_video: Callable[..., Path], tmp_path: Path) -> None:
    make_video("cam0.mp4", 6)
    make_video("cam1.mp4", 4)
    source = open_rig(tmp_path, cameras(2))
    assert numbers(read(source)) == [[i, i] for i in range(4)]
    assert any("differ in length" in line for line in source.warnings)
    assert source.warnings[-1] == "cam1 ended after 4 frames, cam0 go on"


def test_missing_pictures_leave_holes(record: Callable[..., Path]) -> None:
    folder = record(range(6), [0, 1, 3, 4, 5])
    frames = read(open_rig(folder, cameras(2)))
    assert numbers(frames) == [[0, 0], [1, 1], [2, None], [3, 3], [4, 4], [5, 5]]
    assert "no picture of number 2" in (frames[2].problems[1] or "")


def test_numbers_that_do_not_agree_mean_places(record: Callable[..., Path]) -> None:
    source = open_rig(record(range(4), range(20, 24)), cameras(2))
    assert numbers(read(source)) == [[0, 20], [1, 21], [2, 22], [3, 23]]
    assert any("by their place" in line for line in source.warnings)


def test_first_numbers_that_differ(record: Callable[..., Path]) -> None:
    source = open_rig(record(range(6), range(1, 7)), cameras(2))
    assert numbers(read(source)) == [[i, i] for i in range(1, 6)]
    assert any("first numbers differ (cam0 0, cam1 1)" in line for line in source.warnings)


@pytest.mark.parametrize("as_video", [False, True])
def test_offsets(as_video: bool, record: Callable[..., Path], make_video: Callable[..., Path], tmp_path: Path) -> None:
    if as_video:
        for i in range(3):
            make_video(f"cam{i}.mp4", 8)
    else:
        record(range(8), range(8), range(8))
    source = open_rig(tmp_path, cameras(), offsets={"cam1": 2, "cam2": -1})
    assert source.count == 5
    assert numbers(read(source)) == [[i + 1, i + 3, i] for i in range(5)]
    with pytest.raises(InputError, match=r"start 5 lies after the last frame \(4\)"):
        open_rig(tmp_path, cameras(), offsets={"cam1": 2, "cam2": -1}, start=5)
    for offset in (100, -100):
        with pytest.raises(
            InputError, match=f"offset: expected frames that all views have, got none with cam1={offset}$"
        ):
            open_rig(tmp_path, cameras(), offsets={"cam0": 0, "cam1": offset})


@pytest.fixture
def timed(make_clip: Callable[..., Path], picture: Picture) -> Callable[..., None]:
    """timed("cam0.mp4", times) writes a video of numbered pictures that are shown at these times."""

    def make(name: str, times_s: list[float]) -> None:
        pictures = [np.ascontiguousarray(picture(index)[..., ::-1]) for index in range(len(times_s))]
        make_clip(name, pictures, times_s=times_s)

    return make


def test_videos_of_two_rates_belong_together_by_their_times(timed: Callable[..., None], tmp_path: Path) -> None:
    """20 and 59 frames a second: every frame of the slow one with the nearest of the fast one, at its own time."""
    slow, fast = [0.05 * i for i in range(8)], [0.017 * i for i in range(22)]
    timed("cam0.mp4", fast)
    timed("cam1.mp4", slow)
    source = open_rig(tmp_path, cameras(2))
    assert (source.count, source.fps) == (8, pytest.approx(20.0))
    assert source.warnings == [
        "pictures are paired by their times (cam0 58.8235, cam1 20 per second): 8 frames, up to 7 ms apart"
    ]
    frames = read(source)
    nearest = [min(range(22), key=lambda i, at=at: abs(fast[i] - at)) for at in slow]
    assert numbers(frames) == [[fast_one, slow_one] for slow_one, fast_one in enumerate(nearest)]
    assert [frame.numbers for frame in frames] == [(fast_one, i) for i, fast_one in enumerate(nearest)]
    assert np.abs(np.array([frame.time_s for frame in frames]) - slow).max() < 1e-9
    later = read(open_rig(tmp_path, cameras(2), start=3, max_frames=2))
    assert numbers(later) == numbers(frames)[3:5]
    assert [frame.time_s for frame in later] == [frame.time_s for frame in frames[3:5]]
    with pytest.raises(InputError, match=r"start 8 lies after the last frame \(7\)"):
        open_rig(tmp_path, cameras(2), start=8)


def test_dropped_pictures_of_a_video_leave_holes(timed: Callable[..., None], tmp_path: Path) -> None:
    """One of two cameras of 25 frames a second has dropped three: the others are still with those of their time."""
    times = [0.04 * i for i in range(20)]
    timed("cam0.mp4", times)
    timed("cam1.mp4", [at for i, at in enumerate(times) if i not in (9, 10, 11)])
    frames = read(open_rig(tmp_path, cameras(2)))
    expected = [[i, i if i < 9 else None if i < 12 else i - 3] for i in range(20)]
    assert numbers(frames) == expected
    assert "cam1: no picture of this time" in (frames[9].problems[1] or "")
    assert np.abs(np.array([frame.time_s for frame in frames]) - times).max() < 1e-9


def test_videos_of_one_rate_belong_together_by_place(make_video: Callable[..., Path], tmp_path: Path) -> None:
    for i in range(2):
        make_video(f"cam{i}.mp4", 6)
    source = open_rig(tmp_path, cameras(2))
    assert source.warnings == []
    frames = read(source)
    assert [frame.time_s for frame in frames] == [i / 25.0 for i in range(6)]
    assert [frame.numbers for frame in frames] == [(i, i) for i in range(6)]


def test_offsets_in_seconds(make_video: Callable[..., Path], record: Callable[..., Path], tmp_path: Path) -> None:
    """A tenth of a second at 25 frames a second is two and a half: paired by time, half a frame apart."""
    for i in range(3):
        make_video(f"cam{i}.mp4", 8)
    frames = read(open_rig(tmp_path, cameras(), offsets=offsets_of(["cam1=0.08s", "cam2=-.04s"])))
    assert numbers(frames) == [[i + 1, i + 3, i] for i in range(5)]
    assert frames[0].time_s == 0
    assert frames[4].time_s == pytest.approx(0.16)
    with pytest.raises(InputError, match="the cameras' times have nothing in common; expected fewer frames or seconds"):
        open_rig(tmp_path, cameras(), offsets={"cam1": 7.0})
    folders = record(range(8), range(8))
    with pytest.raises(InputError, match="expected seconds for videos, all of which tell their times"):
        open_rig(folders, cameras(2), offsets={"cam1": 0.5})


def test_wrong_offsets(record: Callable[..., Path]) -> None:
    folder = record(range(3), range(3))
    with pytest.raises(InputError, match=r"'cam11' is no camera \(did you mean cam1\?\); allowed: cam0, cam1"):
        open_rig(folder, cameras(2), offsets={"cam11": 1})
    assert offsets_of(["cam1=-3", "a=b=2"]) == {"cam1": -3, "a=b": 2}
    seconds = offsets_of(["cam1=-0.5s", "cam2=2s", "cam3=.25s"])
    assert seconds == {"cam1": -0.5, "cam2": 2.0, "cam3": 0.25}
    assert all(isinstance(value, float) for value in seconds.values())
    for text in ("cam1", "cam1=x", "=3", "cam1=0.5", "cam1=s", "cam1=nans"):
        with pytest.raises(InputError, match=r"expected NAME=FRAMES such as cam1=-3, or seconds as cam1=0\.12s"):
            offsets_of([text])


def test_missing_view_keeps_the_others(record: Callable[..., Path]) -> None:
    folder = record(range(3), range(3))
    source = open_rig(folder, cameras(3))
    assert source.warnings == ["cam2 is left out: cam2: no pictures and no video"]
    frames = read(source)
    assert numbers(frames) == [[i, i, None] for i in range(3)]
    assert frames[1].problems == (None, None, "cam2: no pictures and no video")


def test_view_of_another_size_keeps_the_others(record: Callable[..., Path]) -> None:
    two = cameras(2)
    source = open_rig(record(range(3), range(3)), [two[0], replace(two[1], width=100)])
    assert "expected 100x48 px, the size that camera cam1 was calibrated with, got 64x48" in source.warnings[0]
    frames = read(source)
    assert numbers(frames) == [[i, None] for i in range(3)]
    assert "calibrated with" in (frames[0].problems[1] or "")


def test_no_view_left(record: Callable[..., Path], tmp_path: Path) -> None:
    folder = record(range(2))
    with pytest.raises(InputError, match=r"no view can be used: .*calibrated with"):
        open_rig(folder, [replace(cameras(1)[0], width=100)])
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="no pictures of any camera; expected view_0"):
        open_rig(tmp_path / "empty", cameras(2))
    with pytest.raises(InputError, match="no such folder"):
        open_rig(tmp_path / "nowhere", cameras(2))


@pytest.mark.parametrize("bad", [0, 2])
def test_bad_pictures_have_a_reason(bad: int, record: Callable[..., Path], picture: Picture) -> None:
    """One of another size, and one that cannot be decoded; the first of a folder too."""
    folder = record(range(4), range(4), range(4))
    cv2.imwrite(str(folder / "view_1" / f"{bad:04d}.png"), picture(1, width=32, height=24))
    (folder / "view_2" / f"{bad:04d}.png").write_bytes(b"no picture")
    frames = read(open_rig(folder, cameras()))
    assert numbers(frames) == [[i, None, None] if i == bad else [i, i, i] for i in range(4)]
    assert "got 32x24" in (frames[bad].problems[1] or "")
    assert "no picture that can be decoded" in (frames[bad].problems[2] or "")
    assert all(problem is None for i, frame in enumerate(frames) if i != bad for problem in frame.problems)


def test_black_pictures(record: Callable[..., Path]) -> None:
    folder = record(range(3), range(3))
    cv2.imwrite(str(folder / "view_1" / "0001.png"), np.full((HEIGHT, WIDTH, 3), 4, np.uint8))
    frames = read(open_rig(folder, cameras(2)))
    assert numbers(frames) == [[0, 0], [1, None], [2, 2]]
    assert frames[1].problems == (None, "cam1: the picture is black")


def test_frozen_view(record: Callable[..., Path], picture: Picture) -> None:
    count, last = FROZEN_AFTER + 6, 3  # view_1 stops at picture 3 and comes back for the last
    folder = record(range(count), range(count))
    for index in range(last + 1, count - 1):
        cv2.imwrite(str(folder / "view_1" / f"{index:04d}.png"), picture(last))
    frames = read(open_rig(folder, cameras(2)))
    problems = [frame.problems[1] for frame in frames]
    first = last + FROZEN_AFTER
    assert problems[:first] == [None] * first
    assert all("cam1: frozen, the same picture for" in (problem or "") for problem in problems[first:-1])
    assert problems[-1] is None
    assert all(frame.problems[0] is None for frame in frames)


def test_still_scene_is_not_frozen(record: Callable[..., Path], picture: Picture) -> None:
    folder = record(range(FROZEN_AFTER + 5), range(FROZEN_AFTER + 5))
    for view in ("view_0", "view_1"):
        for path in (folder / view).iterdir():
            cv2.imwrite(str(path), picture(9))
    frames = read(open_rig(folder, cameras(2)))
    assert all(frame.problems == (None, None) for frame in frames)


def test_uncalibrated_views(record: Callable[..., Path], make_video: Callable[..., Path], tmp_path: Path) -> None:
    folder = record([0, 1, 2], [1, 2, 3], [7])
    source = open_uncalibrated(folder)
    assert source.names == ("view_0", "view_1", "view_2")
    assert source.sizes == ((WIDTH, HEIGHT),) * 3
    assert numbers(read(source)) == [[0, None, None], [1, 1, None], [2, 2, None], [None, 3, None], [None, None, 7]]
    video = make_video("alone/clip.mp4", 7)
    assert numbers(read(open_uncalibrated(video, every=3))) == [[0], [3], [6]]
    assert find_views(video.parent) == {"clip": video}
    assert find_views(folder / "view_1") == {"cam0": folder / "view_1"}
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="holds no views; expected folders view_0"):
        find_views(tmp_path / "empty")


def test_masks_are_no_views(record: Callable[..., Path]) -> None:
    folder = record(range(2))
    (folder / "view_0").rename(folder / "left")
    for name in ("masks", "masks_0", "mask_1"):
        (folder / name).mkdir()
        cv2.imwrite(str(folder / name / "0.png"), np.zeros((4, 4), np.uint8))
    assert list(find_views(folder)) == ["left"]


def test_recording_of_the_development_data(data_dir: Path) -> None:
    from torchhand.files.rigs.rig import load_rig

    folder = data_dir / "real" / "stereo_desk"
    with open_rig(folder, load_rig(folder), max_frames=3, offsets={"cam1": 5}) as source:
        frames = list(source)
    assert [frame.problems for frame in frames] == [(None, None)] * 3
    assert all(image is not None and image.shape == (720, 720, 3) for frame in frames for image in frame.images)
