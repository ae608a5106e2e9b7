"""Pose streams: what comes back, what it costs, and files that are none."""

import json
import math
import struct
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from torchhand.cli.benchmarks import recorded_poses
from torchhand.errors import InputError
from torchhand.export import ExportOptions, load_clip, write
from torchhand.export.clip import MotionClip
from torchhand.export.stream.channels import StreamSettings, unwrapped
from torchhand.export.stream.pose_stream import PoseStreamReader, clip_of_stream, encode_clip, write_stream
from torchhand.files import load_hand_model
from torchhand.geometry import rotation_from_vector
from torchhand.hand import DOFS, Side
from torchhand.numerics import wander

MODEL = load_hand_model()


def _clip(frames: int = 120, *, seed: int = 0, side: Side = "left") -> MotionClip:
    seconds = torch.arange(frames, dtype=torch.float64) / 25
    curves = wander(seconds, len(DOFS), torch.Generator().manual_seed(seed))
    poses = torch.cat((0.1 * curves[:, :3], 2.0 * curves[:, 3:6], 0.4 * curves[:, 6:].abs()), -1)
    poses[:, DOFS.index("index_cmc_fe")] = 0.03
    poses[:, DOFS.index("ring_mcp_tw")] = 0
    shape = MODEL.shape_space.default.double() * 1.01
    return MotionClip(model=MODEL, side=side, shape=shape, poses=poses, fps=25.0, name="wander", up="z")


def test_round_trip(tmp_path: Path) -> None:
    clip, settings = _clip(), StreamSettings(step_deg=3.0, root_step_mm=4.0)
    figures = write_stream(clip, tmp_path / "a.thp", settings)
    back = clip_of_stream(tmp_path / "a.thp", MODEL)
    off = (back.poses - clip.poses).abs()
    bound = torch.tensor([settings.dead_zone * settings.step_of(dof) for dof in DOFS], dtype=torch.float64)
    assert bool((off.amax(0) <= bound + 1e-12).all())
    assert bool((off[:, [DOFS.index("index_cmc_fe"), DOFS.index("ring_mcp_tw")]] == 0).all())
    assert float(off[:, 6:].max()) == pytest.approx(math.radians(figures.worst_deg), abs=1e-12)
    moving = [i for i in range(6, 36) if bool((clip.poses[:, i] != clip.poses[0, i]).any())]
    assert math.degrees(float(off[:, moving].mean())) == pytest.approx(figures.mean_deg)
    assert (back.fps, back.side, back.up, back.name, len(back)) == (25.0, "left", "z", "wander", 120)
    assert float((back.shape - clip.shape).abs().max()) < 1e-8
    assert (tmp_path / "a.thp").stat().st_size == figures.header_bytes + figures.motion_bytes
    assert figures.kbit_per_s == pytest.approx(8e-3 * (tmp_path / "a.thp").stat().st_size / 4.8)


def test_finer_steps_cost_more_and_keep_more() -> None:
    figures = [encode_clip(_clip(250), StreamSettings(step_deg=step))[1] for step in (0.5, 2.0, 8.0)]
    assert figures[0].motion_bytes > 1.3 * figures[1].motion_bytes > 1.5 * figures[2].motion_bytes
    assert figures[0].mean_deg < 0.2 < figures[1].mean_deg < 0.7 < figures[2].mean_deg


def test_a_hand_at_rest_is_a_header(tmp_path: Path) -> None:
    clip = replace(_clip(1), poses=_clip().poses[60:61].expand(500, -1).contiguous(), frame=())
    figures = write_stream(clip, tmp_path / "a.thp")
    packets = 500 // StreamSettings().packet_poses + 1
    assert figures.motion_bytes < 16 + 6 * packets  # counts, lengths, checksums, and hardly a pose
    assert (figures.mean_deg, figures.worst_deg) == (0.0, 0.0)
    assert torch.equal(clip_of_stream(tmp_path / "a.thp", MODEL).poses, clip.poses)


def test_turns_of_more_than_half_a_turn_do_not_jump() -> None:
    angle = torch.linspace(0, 9, 300, dtype=torch.float64)
    axis = torch.nn.functional.normalize(torch.tensor([1.0, -2.0, 0.5], dtype=torch.float64), dim=0)
    wrapped = torch.remainder(angle + math.pi, 2 * math.pi) - math.pi
    vectors = wrapped[:, None] * axis
    smooth = unwrapped(vectors)
    assert float(smooth.diff(dim=0).norm(dim=-1).max()) < 0.04
    assert float((rotation_from_vector(smooth) - rotation_from_vector(vectors)).abs().max()) < 1e-12
    assert torch.equal(unwrapped(smooth), smooth)


def test_under_the_roof_of_all_formats_and_back(tmp_path: Path) -> None:
    clip = _clip(50)
    (note,) = write(clip, tmp_path / "a.thp")
    assert "kbit/s and a header of" in note
    write(clip, tmp_path / "b.thp", options=ExportOptions(stream_step_deg=0.5))
    assert (tmp_path / "b.thp").stat().st_size > (tmp_path / "a.thp").stat().st_size
    back = load_clip(tmp_path / "b.thp", fps=50.0)
    assert (back.fps, back.up, back.side) == (50.0, "z", "left")
    assert float((back.poses - clip.poses).abs().max()) < math.radians(0.3)
    with pytest.raises(InputError, match="got a pose stream, which has its own"):
        load_clip(tmp_path / "b.thp", hand=tmp_path / "hand.json")
    with pytest.raises(ValueError, match="--stream-step-deg: expected more than 0, 30 at most, got 0"):
        ExportOptions(stream_step_deg=0.0)


def test_recorded_motion_within_a_degree_and_a_kilobit(data_dir: Path) -> None:
    for path in sorted((data_dir / "real" / "joint_angles").glob("*.txt")):
        poses = recorded_poses(MODEL, path)
        shape = MODEL.shape_space.default.double()
        clip = MotionClip(model=MODEL, side="right", shape=shape, poses=poses, fps=25.0)
        _, figures = encode_clip(clip)
        assert figures.mean_deg <= 1.0
        assert figures.kbit_per_s <= 1.0


def _changed(data: bytes, **entries: object) -> bytes:
    """The stream with other entries in its header, its length and checksum right."""
    length, _ = struct.unpack("<II", data[4:12])
    record = json.loads(zlib.decompress(data[12 : 12 + length])) | entries
    packed = zlib.compress(json.dumps({k: v for k, v in record.items() if v is not None}).encode())
    return data[:4] + struct.pack("<II", len(packed), zlib.crc32(packed)) + packed + data[12 + length :]


def test_streams_are_decoded_while_they_grow() -> None:
    """Whatever pieces they come in: all poses of whole packets, each as soon as its packet is whole."""
    clip = replace(_clip(50), frame=tuple(range(100, 150)), held=(107, 108))
    data, figures = encode_clip(clip, StreamSettings(packet_poses=12))
    reader, poses, held = PoseStreamReader(MODEL), [], []
    for place in range(len(data)):
        found, is_held = reader.feed(data[place : place + 1])
        poses.append(found)
        held.append(is_held)
        assert (reader.header is None) == (place + 1 < figures.header_bytes)
    assert [len(one) for one in poses if len(one)] == [12, 12, 12, 12, 2]
    assert reader.has_ended
    whole, _ = PoseStreamReader(MODEL).feed(data)
    assert torch.equal(torch.cat(poses), whole)
    assert np.flatnonzero(np.concatenate(held)).tolist() == [7, 8]
    assert float((whole - clip.poses)[:, 6:].abs().max()) < math.radians(0.56 * 3.5)


def test_small_packets_cost_bits_and_nothing_else() -> None:
    costs = [encode_clip(_clip(200), StreamSettings(packet_poses=size))[1] for size in (1, 15, 200)]
    assert costs[0].motion_bytes > costs[1].motion_bytes > costs[2].motion_bytes
    assert {one.worst_deg for one in costs} == {costs[0].worst_deg}


def test_a_stream_that_was_cut_gives_its_whole_packets(tmp_path: Path) -> None:
    data, figures = encode_clip(_clip(50), StreamSettings(packet_poses=10))
    whole = PoseStreamReader(MODEL).feed(data)[0]
    path = tmp_path / "a.thp"
    for cut, poses in ((1, 50), (5, 50), (6, 40)):
        path.write_bytes(data[:-cut])
        clip = clip_of_stream(path, MODEL)
        assert torch.equal(clip.poses, whole[:poses])
        assert clip.notes == (f"the stream has no end yet: the {poses} poses that are whole were read",)
    path.write_bytes(data[: figures.header_bytes + 3])
    with pytest.raises(InputError, match="is cut short: expected a header and a packet of poses"):
        clip_of_stream(path, MODEL)


def test_every_flipped_bit_of_the_motion_is_told(tmp_path: Path) -> None:
    """Of a length too, which may swallow the packets that follow: the end of the stream is still there."""
    data, figures = encode_clip(_clip(20), StreamSettings(packet_poses=10))
    path = tmp_path / "a.thp"
    for place in range(figures.header_bytes, len(data) - 5):  # the last five bytes are the end
        for bit in range(8):
            path.write_bytes(data[:place] + bytes([data[place] ^ (1 << bit)]) + data[place + 1 :])
            with pytest.raises(InputError, match="is damaged"):
                clip_of_stream(path, MODEL)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda d: b"", "is cut short: expected a header and a packet of poses, got 0 bytes"),
        (lambda d: b"glTF" + d, "expected a pose stream that begins with 'THP', got b'glT'"),
        (lambda d: b"THP1" + d[4:], "expected a pose stream of version 2, got b'1'"),
        (lambda d: d[:10], "is cut short: expected a header and a packet of poses, got 10 bytes"),
        (lambda d: d + b"x", "goes on after its end by 1 bytes"),
        (lambda d: d[:40] + bytes([d[40] ^ 4]) + d[41:], "header: is damaged: its checksum is not that of its content"),
        (lambda d: d[:-8] + bytes([d[-8] ^ 4]) + d[-7:], "is damaged: packet 1 has another checksum than its content"),
        (lambda d: _changed(d, fps=None), "expected an entry 'fps', it has none"),
        (lambda d: _changed(d, fps=-1), "fps: expected more than 0"),
        (lambda d: _changed(d, first="a"), "first: expected the number of a frame, got 'a'"),
        (lambda d: _changed(d, side="both"), "side: expected one of left, right, got 'both'"),
        (lambda d: _changed(d, dofs=["a"]), "dofs: expected names of degrees of freedom"),
        (lambda d: _changed(d, steps=[1.0]), "steps: expected a list of 34, got 1"),
        (lambda d: _changed(d, still={"x": 1}), "still: expected degrees of freedom that do not move, got 'x'"),
        (lambda d: _changed(d, shape={"length": 1}), "shape: expected the parameters of generic_hand, got others"),
        (lambda d: _changed(d, up="x"), "up: expected one of y, -y, z, -z, got 'x'"),
        (lambda d: _changed(d, name=3), "name: expected a text, got 3"),
    ],
)
def test_files_that_are_no_streams(tmp_path: Path, spoil, message: str) -> None:
    data, _ = encode_clip(_clip(20))
    path = tmp_path / "a.thp"
    path.write_bytes(spoil(data))
    with pytest.raises(InputError) as caught:
        clip_of_stream(path, MODEL)
    assert message in str(caught.value)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_missing_files_and_headers_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        clip_of_stream(tmp_path / "none.thp", MODEL)
    for packed in (b"nonsense", zlib.compress(b"[1]"), zlib.compress(b"{")):
        data = b"THP2" + struct.pack("<II", len(packed), zlib.crc32(packed)) + packed
        (tmp_path / "a.thp").write_bytes(data)
        with pytest.raises(InputError, match="header: expected "):
            clip_of_stream(tmp_path / "a.thp", MODEL)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"step_deg": 0.0}, "step_deg: expected more than 0, 30 at most, got 0"),
        ({"root_step_mm": np.inf}, "root_step_mm: expected more than 0, 1000 at most, got inf"),
        ({"dead_zone": 0.2}, "dead_zone: expected 0.5 to 1, got 0.2"),
    ],
)
def test_settings(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        StreamSettings(**settings)
