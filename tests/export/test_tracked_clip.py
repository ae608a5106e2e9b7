"""Results of tracking as clips: gaps, wrong files, frames of reference."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from torchhand.errors import InputError
from torchhand.export.clip import MotionClip, rest_clip
from torchhand.export.formats import write
from torchhand.export.stream import clip_of_stream
from torchhand.export.tracked_clip import load_clip
from torchhand.files import load_track
from torchhand.files.results import write_npz
from torchhand.geometry import rotation_from_vector
from torchhand.hand import DOFS, HandModel
from torchhand.hand.conventions import mano_from_hand


def test_a_result_gives_its_poses(make_result: Callable[..., Path]) -> None:
    folder = make_result()
    clip = load_clip(folder, fps=50.0)
    assert np.array_equal(clip.poses.numpy(), load_track(folder).pose)
    assert (clip.frame, clip.held, clip.fps, clip.side, clip.name) == (tuple(range(6)), (), 50.0, "right", "result")
    assert torch.equal(clip.seconds, torch.arange(6, dtype=torch.float64) / 50)
    for file in ("track.npz", "../result"):
        assert torch.equal(load_clip(folder / file).poses, clip.poses)


def test_pictures_that_were_fitted_with_one_hand_give_its_poses(
    make_result: Callable[..., Path], model: HandModel
) -> None:
    folder = make_result(lost=(1,), side="each picture's own", hand_side="left")
    track, hand = load_track(folder), folder / "hand.json"
    shapes = np.tile(1.01 * model.shape_space.default.double().numpy(), (6, 1))
    shapes[1] = np.nan
    arrays = track.arrays() | {"image": np.array([f"{i}.png" for i in range(6)]), "side": np.array(["left"] * 6)}
    arrays |= {"shape": shapes, "shape_names": np.array(model.shape_space.names)}
    np.savez(folder / "poses.npz", **arrays)  # type: ignore[arg-type]
    (folder / "track.npz").unlink()
    hand = hand.rename(folder.parent / "hand.json")
    clip = load_clip(folder, gaps="cut")
    assert (clip.side, clip.frame) == ("left", (0, 2, 3, 4, 5))
    assert np.array_equal(clip.poses.numpy(), track.pose[[0, 2, 3, 4, 5]])
    assert np.array_equal(clip.shape.numpy(), shapes[0])
    assert torch.equal(load_clip(folder, hand=hand).shape, model.shape_space.default.double())
    for name, array, got in (
        ("shape", shapes * (1 + 1e-3 * np.arange(6)[:, None]), "5 pictures with a hand each"),
        ("side", np.array(["left", "left", "right", "left", "left", "left"]), "5 pictures with a hand each"),
        ("shape", np.full_like(shapes, np.nan), "pictures without any"),
    ):
        np.savez(folder / "poses.npz", **arrays | {name: array})  # type: ignore[arg-type]
        with pytest.raises(InputError, match=rf"poses\.npz: expected one hand, got {got}: fit one picture alone"):
            load_clip(folder)


def test_held_gaps_repeat_the_last_pose(make_result: Callable[..., Path]) -> None:
    clip = load_clip(make_result(lost=(0, 2, 3, 5)), gaps="hold")
    known = load_clip(make_result(name="whole")).poses
    assert torch.equal(clip.poses, known[[1, 1, 1, 1, 4, 4]])
    assert clip.held == (0, 2, 3, 5)
    assert clip.frame == tuple(range(6))


def test_cut_gaps_are_left_out(make_result: Callable[..., Path]) -> None:
    clip = load_clip(make_result(lost=(0, 2, 3, 5)), gaps="cut")
    known = load_clip(make_result(name="whole")).poses
    assert torch.equal(clip.poses, known[[1, 4]])
    assert (clip.frame, clip.held) == ((1, 4), ())
    assert torch.equal(clip.seconds, torch.tensor([0.0, 3 / 30], dtype=torch.float64))


def test_numbers_that_the_track_skips_are_gaps(make_result: Callable[..., Path]) -> None:
    folder = make_result(frames=3, numbers=(4, 6, 9))
    held, cut = load_clip(folder), load_clip(folder, gaps="cut")
    assert (held.frame, held.held, cut.frame) == ((4, 5, 6, 7, 8, 9), (5, 7, 8), (4, 6, 9))
    assert torch.equal(held.poses, cut.poses[[0, 0, 1, 1, 1, 2]])


@pytest.mark.parametrize("gaps", ["hold", "cut"])
def test_a_track_without_any_pose_is_refused(make_result: Callable[..., Path], gaps) -> None:
    with pytest.raises(InputError, match=r"expected at least one tracked frame, got none in 6 frames: all are lost"):
        load_clip(make_result(lost=tuple(range(6))), gaps=gaps)


def test_times_and_rate_are_those_of_the_track(make_result: Callable[..., Path]) -> None:
    """By its times, else by its header; the video is not looked at again."""
    folder = make_result(lost=(2,))
    assert load_clip(folder).fps == 30.0
    track = load_track(folder)
    told = {"side": "right", "source": "gone.mp4", "made_with": {"frames_per_second": 59.94}}
    write_npz(replace(track, header=told), folder / "track.npz")
    assert load_clip(folder).fps == 59.94
    times = np.array([1.0, 1.04, 1.08, 1.2, 1.24, 1.28])
    write_npz(replace(track, header=told, time_s=times), folder / "track.npz")
    for gaps in ("hold", "cut"):
        clip = load_clip(folder, gaps=gaps)
        kept = times if gaps == "hold" else np.delete(times, 2)
        assert clip.fps == pytest.approx(25.0)
        assert np.abs(clip.seconds.numpy() - (kept - 1.0)).max() < 1e-12
    even = load_clip(folder, fps=7.0)
    assert even.fps == 7.0
    assert np.abs(even.seconds.numpy() - np.arange(6) / 7).max() < 1e-12


def test_uneven_times_become_even_ones_where_a_format_has_one_rate(clip: MotionClip) -> None:
    """A clip of which frames are left out is the same motion again once poses are interpolated to its rate."""
    start, end = clip.poses[:1], clip.poses[-1:]
    share = torch.arange(9, dtype=torch.float64)[:, None] / 8
    line = start + share * (end - start)
    line[:, 3:6] = torch.tensor((0.1, -0.2, 0.3), dtype=torch.float64) * (1 + 5 * share)  # about one axis
    whole = replace(clip, poses=line, frame=())
    kept = [0, 1, 3, 4, 8]
    cut = replace(clip, poses=line[kept], frame=tuple(kept))
    even = cut.at_constant_rate()
    assert even.frame == tuple(range(9))
    assert float((even.poses - whole.poses).abs().max()) < 1e-12
    assert whole.at_constant_rate() is whole


def test_a_pause_lasts_so_long_at_most_where_a_format_has_one_rate(
    make_result: Callable[..., Path], tmp_path: Path
) -> None:
    """Six frames of 25 a second with an hour between the third and the fourth: the hour becomes two seconds, whether
    frames are numbered by time or on, and one line tells it; formats that know times keep it."""
    folder = make_result()
    track = load_track(folder)
    times = np.array([0.0, 0.04, 0.08, 3600.08, 3600.12, 3600.16])
    for number in (track.frame, np.array([0, 1, 2, 90_002, 90_003, 90_004])):
        write_npz(replace(track, frame=number, time_s=times), folder / "track.npz")
        clip = load_clip(folder)
        assert float(clip.seconds[-1]) == pytest.approx(3600.16)
        even = replace(clip, max_gap_s=2.0).at_constant_rate()
        assert len(even) == 2 + 50 + 3
        assert float((even.poses[:3] - clip.poses[:3]).abs().max()) < 1e-12
        assert float((even.poses[-3:] - clip.poses[-3:]).abs().max()) < 1e-12
        path = tmp_path / f"{number[-1]}.thp"
        [line, _] = write(replace(clip, max_gap_s=2.0), path)
        assert "1 gap(s) without frames, 3600.0 s the longest, last 2 s here (--max-gap-s)" in line
        assert len(clip_of_stream(path, clip.model)) == len(even)
    assert replace(clip, max_gap_s=3600.0).gap_notes() == []
    with pytest.raises(ValueError, match=r"max_gap_s: expected more than 0, 86400 \(a day\) at most, got 0"):
        replace(clip, max_gap_s=0.0)


def test_axes_of_an_export(clip: MotionClip) -> None:
    """The wrist's frames do not see how the hand is placed; the others are turned as a whole."""
    turn = rotation_from_vector(clip.poses[:, 3:6])
    points = clip.frames.keypoints
    own = (points - points[:, :1]) @ turn
    for axes, expected in (("wrist", own), ("mano", own @ mano_from_hand(clip.side).mT)):
        placed = replace(clip, axes=axes).placed("camera")
        assert float((placed.frames.keypoints - expected).abs().max()) < 1e-12
    assert torch.equal(replace(clip, axes="camera").placed("y-up").frames.keypoints, points)
    upright = replace(clip, axes="z-up").placed("camera").frames.keypoints
    expected = points @ torch.tensor([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]], dtype=torch.float64)
    assert float((upright - expected).abs().max()) < 1e-12
    mano = replace(clip, axes="mano").placed("camera").frames.keypoints
    forwards = mano[:, 9, 0]  # the knuckle of the middle finger: along -x of a right hand, +x of a left one
    assert bool((forwards < -0.05).all() if clip.side == "right" else (forwards > 0.05).all())


def test_a_hand_file_alone_gives_the_open_hand_upright(make_result: Callable[..., Path], model: HandModel) -> None:
    clip = load_clip(make_result(side="left") / "hand.json")
    assert model.mesh is not None
    assert len(clip) == 1
    assert clip.side == "left"
    assert torch.equal(clip.poses[0, 6:], model.mesh.bind_pose[6:])
    points = clip.with_up("y").frames.keypoints[0]
    middle_tip, palm = points[12], points[[5, 9, 17]].mean(0)
    assert middle_tip[1] > 0.9 * float(clip.shape[0] - 0.003)
    vertices = clip.vertices()[0]
    thumb_tip = points[4]
    assert thumb_tip[2] > palm[2] + 0.01  # the palm, towards which the thumb lies, faces the viewer
    assert vertices[:, 1].min() < 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda folder: (folder / "hand.json").unlink(), "hand.json: no such file"),
        (lambda folder: (folder / "hand.json").write_text("{}"), "expected a hand file"),
        (
            lambda folder: (folder / "track.npz").unlink(),
            "expected a folder with track.npz, track.jsonl, poses.npz or keypoints_fit.npz, found none",
        ),
        (lambda folder: (folder / "track.npz").write_bytes(b"PK\x03\x04 cut"), "is no track that can be read"),
        (
            lambda folder: (folder / "hand.json").write_text(
                (folder / "hand.json").read_text().replace('"hand_length": 0.187', '"hand_length": 18.7')
            ),
            "hand_length: expected 0.14 to 0.24 m, got 18.7",
        ),
    ],
)
def test_broken_results_are_refused(make_result: Callable[..., Path], change, message: str) -> None:
    folder = make_result()
    change(folder)
    with pytest.raises(InputError, match=re.escape(message)):
        load_clip(folder)


def test_other_files_and_other_hands_are_refused(make_result: Callable[..., Path], tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file or folder"):
        load_clip(tmp_path / "nothing")
    (tmp_path / "song.mp3").write_bytes(b"ID3")
    with pytest.raises(InputError, match=r"expected a result folder, track\.npz, .*, got '\.mp3'"):
        load_clip(tmp_path / "song.mp3")
    with pytest.raises(InputError, match="expected a left hand as in the hand file, got a right one"):
        load_clip(make_result(hand_side="left"))
    with pytest.raises(InputError, match="side: expected a left hand, got a right one"):
        load_clip(make_result(name="right"), side="left")
    with pytest.raises(InputError, match="dof_names: expected the 36"):
        load_clip(make_result(name="other", dof_names=DOFS[::-1]))
    with pytest.raises(InputError, match="expected numbers within 1000000"):
        load_clip(make_result(name="long", frames=2, numbers=(0, 1 << 40)))
    with pytest.raises(InputError, match="expected increasing numbers"):
        load_clip(make_result(name="back", frames=2, numbers=(1, 0)))


def test_clips_hold_no_gaps(clip: MotionClip) -> None:
    poses = clip.poses.clone()
    poses[2, 8] = torch.nan
    with pytest.raises(ValueError, match="NaN or infinite ones in frame 2"):
        replace(clip, poses=poses)
    with pytest.raises(ValueError, match="expected one frame or more"):
        replace(clip, poses=poses[:0], frame=())
    with pytest.raises(ValueError, match="fps: expected more than 0"):
        replace(clip, fps=0.0)
    with pytest.raises(ValueError, match="frame: expected 7 numbers"):
        replace(clip, frame=(1, 2))
    with pytest.raises(ValueError, match="names: expected the 36"):
        replace(clip, names=DOFS[1:])


def test_another_axis_up_is_the_same_motion_turned(clip: MotionClip) -> None:
    for up, turn in (
        ("y", Rotation.from_euler("x", 180, degrees=True)),
        ("z", Rotation.from_euler("x", -90, degrees=True)),
    ):
        turned = clip.with_up("y" if up == "y" else "z")
        expected = clip.frames.keypoints.numpy() @ turn.as_matrix().T
        assert np.abs(turned.frames.keypoints.numpy() - expected).max() < 1e-12
        assert turned.up == up
    assert torch.allclose(
        clip.with_up("z").with_up("y").poses[:, :3], clip.with_up("y").poses[:, :3], rtol=0, atol=1e-15
    )


def test_one_frame_of_a_clip(clip: MotionClip, model: HandModel) -> None:
    one = replace(clip, frame=tuple(range(10, 17)), held=(12,)).only(12)
    assert (one.frame, one.held) == ((12,), (12,))
    assert torch.equal(one.poses, clip.poses[2:3])
    with pytest.raises(ValueError, match="expected the number of a frame in the clip, 0 to 6, got 7"):
        clip.only(7)
    assert len(rest_clip(model, "right")) == 1
