"""Video files: in order, without trust in the container."""

import weakref
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
import torch

from torchhand.errors import InputError
from torchhand.files.pictures.frame_source import Frame
from torchhand.files.pictures.frames import open_source
from torchhand.files.pictures.video import VideoSource, _Clock

FRAMES = 40


def _number(frame: Frame) -> int:
    """The number that the picture shows."""
    assert frame.image is not None
    bands = frame.image[:, 36:60].float().unflatten(0, (6, 8)).mean((1, 2, 3))
    return sum(1 << bit for bit in range(6) if bands[bit] > 128)


def test_frames_come_in_order_as_rgb(make_video):
    with open_source(make_video(frames=12)) as source:
        assert (source.width, source.height, source.fps, source.count) == (64, 48, 25.0, 12)
        frames = list(source)
    assert [frame.index for frame in frames] == list(range(12))
    assert [_number(frame) for frame in frames] == list(range(12))
    left = frames[0].image[8:40, 4:28].float().mean((0, 1))  # pyright: ignore[reportOptionalSubscript]
    torch.testing.assert_close(left, torch.tensor([20.0, 60.0, 200.0]), atol=6.0, rtol=0.0)
    assert source.ended_early is None


@pytest.mark.parametrize(
    ("start", "max_frames", "already_done"), [(3, None, 0), (0, 5, 0), (3, 5, 2), (3, 100, 0), (3, 4, 4)]
)
def test_a_range_of_frames(make_video, start: int, max_frames: int | None, already_done: int):
    last = 12 if max_frames is None else min(12, start + max_frames)
    with open_source(make_video(), start=start, max_frames=max_frames, already_done=already_done) as source:
        frames = list(source)
        assert source.count == len(frames)
    assert [frame.index for frame in frames] == list(range(start + already_done, last))
    assert [_number(frame) for frame in frames] == [frame.index for frame in frames]


def test_a_start_after_the_end_is_an_error_but_nothing_left_to_do_is_none(make_video):
    path = make_video(frames=5)
    with (
        open_source(path, start=5) as source,
        pytest.raises(InputError, match=r"start 5 lies after the last frame \(4\)"),
    ):
        list(source)
    with open_source(path, start=2, already_done=3) as source:
        assert list(source) == []


def test_corrupt_frames_in_the_middle_are_reported_and_the_rest_keeps_its_numbers(make_video, capfd):
    path = make_video(frames=FRAMES)
    data = bytearray(path.read_bytes())
    headers = [i for i in range(len(data)) if data[i : i + 4] == b"\x00\x00\x01\xb6"]  # MPEG-4 picture headers
    assert len(headers) == FRAMES
    for number in (14, 15):
        data[headers[number] : headers[number + 1]] = bytes(headers[number + 1] - headers[number])
    path.write_bytes(data)
    with open_source(path) as source:
        frames = list(source)
    assert [frame.index for frame in frames] == list(range(FRAMES))
    bad = [frame for frame in frames if frame.image is None]
    assert {14, 15} <= {frame.index for frame in bad} <= {14, 15, 16}
    assert bad[0].problem == f"{path}: frame 14 is corrupt"
    assert all(_number(frame) == frame.index for frame in frames[24:])  # from the next key frame on
    assert capfd.readouterr().err == ""


def test_a_video_that_breaks_off_ends_there_without_phantom_frames(make_video, capfd):
    path = make_video("clip.avi", FRAMES, codec="MJPG")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with open_source(path) as source:
        frames = list(source)
    assert 10 <= len(frames) < FRAMES - 10
    assert all(_number(frame) == frame.index for frame in frames[:-1])
    assert source.ended_early == f"{path}: the container promises {FRAMES} frames, {len(frames)} could be read"
    assert capfd.readouterr().err == ""


def test_an_impossible_frame_rate_becomes_thirty(make_clip, picture):
    path = make_clip("fast.mkv", [picture(i) for i in range(4)], codec="mjpeg", pix_fmt="yuvj420p", fps=90000)
    with open_source(path) as source:
        assert source.fps == 30.0
        assert [frame.time_s for frame in source] == pytest.approx([0, 1 / 30, 2 / 30, 3 / 30])


def _frames_of_avi(data: bytearray) -> list[tuple[int, int]]:
    """Where the pictures of an AVI file begin and end."""
    found, at = [], data.index(b"movi") + 4
    while (at := data.find(b"00dc", at)) >= 0 and at < data.index(b"idx1"):
        size = int.from_bytes(data[at + 4 : at + 8], "little")
        found.append((at + 8, at + 8 + size))
        at += 8 + size
    return found


@pytest.mark.parametrize("count", [0, 2, 7, 500, 2**32 - 1])
def test_a_container_may_lie_about_its_frame_count(make_video, count: int, capfd):
    path = make_video("clip.avi", 7, codec="MJPG")
    data = bytearray(path.read_bytes())
    for at in (data.index(b"avih") + 24, data.index(b"strh") + 40):
        assert data[at : at + 4] == (7).to_bytes(4, "little")
        data[at : at + 4] = count.to_bytes(4, "little")
    for index in (0, 3, 4):
        begin, end = _frames_of_avi(data)[index]
        data[begin:end] = bytes(end - begin)
    path.write_bytes(data)
    with open_source(path, start=1) as source:
        frames = list(source)
    assert [(frame.index, frame.image is None) for frame in frames] == [
        (1, False), (2, False), (3, True), (4, True), (5, False), (6, False)
    ]  # fmt: skip
    assert [_number(frame) for frame in frames if frame.image is not None] == [1, 2, 5, 6]
    assert [frame.time_s for frame in frames] == pytest.approx([frame.index / 25 for frame in frames])
    assert (source.ended_early is not None) == (count == 500)
    assert capfd.readouterr().err == ""


def test_a_video_without_a_single_frame(make_video, capfd):
    path = make_video("clip.avi", 7, codec="MJPG")
    data = bytearray(path.read_bytes())
    for begin, end in _frames_of_avi(data):
        data[begin:end] = bytes(end - begin)
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"clip.avi: not a single frame can be decoded"):
        open_source(path)
    assert capfd.readouterr().err == ""


def test_a_picture_size_that_changes(make_clip, picture, tmp_path: Path):
    large = make_clip("large.mkv", [picture(i) for i in range(2)], codec="mjpeg", pix_fmt="yuvj420p")
    small = make_clip("small.mkv", [picture(2, width=32, height=24)], codec="mjpeg", pix_fmt="yuvj420p")
    path = tmp_path / "both.mkv"
    with av.open(str(path), "w") as joined, av.open(str(large)) as one, av.open(str(small)) as other:
        stream = joined.add_stream_from_template(one.streams.video[0])
        for index, packet in enumerate(p for container in (one, other) for p in container.demux(video=0) if p.size):
            packet.stream, packet.pts, packet.dts = stream, 40 * index, 40 * index
            joined.mux(packet)
    with (
        open_source(path) as source,
        pytest.raises(InputError, match="frame 2: expected a picture of 64x48 px like the first, got 32x24"),
    ):
        list(source)


def test_a_variable_rate_keeps_its_times(make_clip, picture):
    times_s = [0.0, 0.040, 0.060, 0.200, 0.240, 0.841, 0.900]
    path = make_clip("vfr.mkv", [picture(i)[..., ::-1] for i in range(7)], times_s=times_s)  # with B-frames
    with open_source(path) as source:
        frames = list(source)
    assert [_number(frame) for frame in frames] == list(range(7))
    assert [frame.time_s for frame in frames] == pytest.approx(times_s, abs=1e-9)
    with open_source(path, start=3, already_done=1) as source:
        assert [frame.time_s for frame in source] == [frame.time_s for frame in frames[4:]]


def test_a_variable_rate_is_no_lack_of_frames_but_a_file_that_is_cut_off_is(make_clip):
    times_s = [0.04 * i + (0.4 if i >= 10 else 0.0) + 0.01 * (i % 2) for i in range(20)]  # 1.2 s, a pause in them
    noise = np.random.default_rng(0).integers(0, 256, (20, 48, 64, 3), dtype=np.uint8)  # more bytes than any header
    path = make_clip("clip.mkv", list(noise), codec="mjpeg", pix_fmt="yuvj420p", times_s=times_s)
    with open_source(path) as source:
        assert len(list(source)) == 20
    assert source.ended_early is None
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with open_source(path) as source:
        frames = list(source)
    told = f"1.21 s, {len(frames)} frames could be read, the last at {frames[-1].time_s:.2f} s"
    assert source.ended_early == f"{path}: the container promises {told}"


@pytest.mark.parametrize(
    ("pts", "expected"),
    [
        ([5, 6, 6, 7, 8], [0.0, 0.1, 0.14, 0.2, 0.3]),  # said twice
        ([None, None, None], [0.0, 0.04, 0.08]),
        ([None, 30, 31], [0.0, 0.04, 0.1]),  # told from the second on, to the nearest unit
        ([9, 2, 10], [0.0, 0.04, 0.1]),  # backwards
    ],
)
def test_times_only_grow(pts: list[int | None], expected: list[float]):
    clock = _Clock(0.1, 0.04)
    assert [clock(one) for one in pts] == pytest.approx(expected)


def test_a_turned_video_stands_upright(make_clip, picture):
    wide = picture(0)[..., ::-1]
    wide[:8, :8] = (0, 255, 0)  # the top left corner, which is at the top right when it is turned clockwise
    path = make_clip("turned.mp4", [wide] * 3, turned=True)
    with open_source(path) as source:
        assert (source.width, source.height) == (48, 64)
        images = [frame.image for frame in source]
    assert all(image is not None and image.shape == (64, 48, 3) for image in images)
    corner = images[0][2:6, 42:46].float().mean((0, 1))  # pyright: ignore[reportOptionalSubscript]
    torch.testing.assert_close(corner, torch.tensor([0.0, 255.0, 0.0]), atol=20.0, rtol=0.0)


@pytest.mark.skipif(
    int(cv2.__version__.split(".")[0]) < 5 or int(av.__version__.split(".")[0]) < 18,
    reason="older ones have other FFmpegs than each other, and OpenCV 4 takes every matrix for BT.601",
)
@pytest.mark.parametrize(
    ("codec", "pix_fmt", "options", "levels"),
    [
        ("libx264", "yuv420p", {}, 2),
        ("libx264", "yuv420p", {"colorspace": "bt709", "color_range": "tv"}, 2),
        ("libx264", "yuv420p", {"colorspace": "smpte170m", "color_range": "tv"}, 2),
        ("libx264", "yuvj420p", {"color_range": "pc"}, 2),
        ("libx264", "yuv420p10le", {}, 5),  # of which the two dither differently
        ("libx264", "gray", {}, 2),
        ("mjpeg", "yuvj422p", {}, 2),
        ("ffv1", "bgr0", {}, 2),
        ("ffv1", "gray16le", {}, 2),
    ],
)
def test_pixels_are_those_of_opencv(make_clip, codec: str, pix_fmt: str, options: dict[str, str], levels: int):
    """In every sampling, depth, matrix and range: another matrix is off by twenty levels, another range by sixteen."""
    ramp = np.linspace(0, 255, 64, dtype=np.uint8)
    image = np.stack([np.tile(ramp, (48, 1)), np.tile(ramp[::-1], (48, 1)), np.tile(ramp[:48, None], (1, 64))], -1)
    path = make_clip("a.mkv", [image] * 2, codec=codec, pix_fmt=pix_fmt, options=options)
    good, other = cv2.VideoCapture(str(path)).read()
    assert good
    with open_source(path) as source:
        own = next(iter(source)).image
    assert own is not None
    difference = np.abs(own.numpy().astype(int) - other[..., ::-1].astype(int))
    assert difference.max() <= levels
    assert difference.mean() < 1.5
    assert own.float().std() > 20  # ramps, and no grey


def test_a_truncated_container_cannot_be_opened(make_video, capfd):
    path = make_video()
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(InputError, match=r"clip.mp4: is no video that can be opened"):
        open_source(path)
    assert capfd.readouterr().err == ""


def test_a_source_is_read_once(make_video):
    source = open_source(make_video(frames=2))
    assert len(list(source)) == 2
    with pytest.raises(ValueError, match="read once"):
        next(iter(source))


def test_frames_are_let_go_of(make_video):
    """A stream: memory does not grow with length."""
    handed_out = []
    with open_source(make_video(frames=FRAMES)) as source:
        for frame in source:
            handed_out.append(weakref.ref(frame.image))
            assert sum(image() is not None for image in handed_out) <= 2
    assert len(handed_out) == FRAMES


def test_a_video_with_an_unreliable_index_is_read_whole(data_dir: Path, capfd):
    path = data_dir / "real" / "open_hand_wave" / "hand_white.mov"
    with open_source(path) as source:
        assert isinstance(source, VideoSource)
        assert (source.width, source.height) == (640, 426)
        assert 28.0 < source.fps < 29.0
        kept, indices = {}, []
        for frame in source:
            assert frame.image is not None
            indices.append(frame.index)
            if frame.index in (120, 121):
                kept[frame.index] = frame.image
    assert indices == list(range(206))
    with open_source(path, start=120, max_frames=2) as source:
        again = {frame.index: frame.image for frame in source}
    assert all(np.array_equal(again[i], kept[i]) for i in (120, 121))  # pyright: ignore[reportArgumentType]
    assert capfd.readouterr().err == ""
