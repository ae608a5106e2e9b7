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
from torchhand.export.tracked_clip import load_clip
from torchhand.files import load_track, write_video
from torchhand.files.results import write_npz
from torchhand.hand import DOFS, HandModel


def test_a_result_gives_its_poses(make_result: Callable[..., Path]) -> None:
    folder = make_result()
    clip = load_clip(folder, fps=50.0)
    assert np.array_equal(clip.poses.numpy(), load_track(folder).pose)
    assert (clip.frame, clip.held, clip.fps, clip.side, clip.name) == (tuple(range(6)), (), 50.0, "right", "result")
    assert torch.equal(clip.seconds, torch.arange(6, dtype=torch.float64) / 50)
    for file in ("track.npz", "../result"):
        assert torch.equal(load_clip(folder / file).poses, clip.poses)


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
    assert torch.equal(clip.seconds, torch.tensor([0.0, 1 / 30], dtype=torch.float64))


def test_numbers_that_the_track_skips_are_gaps(make_result: Callable[..., Path]) -> None:
    folder = make_result(frames=3, numbers=(4, 6, 9))
    held, cut = load_clip(folder), load_clip(folder, gaps="cut")
    assert (held.frame, held.held, cut.frame) == ((4, 5, 6, 7, 8, 9), (5, 7, 8), (4, 6, 9))
    assert torch.equal(held.poses, cut.poses[[0, 0, 1, 1, 1, 2]])


@pytest.mark.parametrize("gaps", ["hold", "cut"])
def test_a_track_without_any_pose_is_refused(make_result: Callable[..., Path], gaps) -> None:
    with pytest.raises(InputError, match=r"expected at least one tracked frame, got none in 6 frames: all are lost"):
        load_clip(make_result(lost=tuple(range(6))), gaps=gaps)


def test_the_rate_is_that_of_the_source_video(make_result: Callable[..., Path], tmp_path: Path) -> None:
    folder = make_result()
    assert load_clip(folder).fps == 30.0
    video = tmp_path / "clip.mp4"
    with write_video(video, width=32, height=32, fps=12.0) as writer:
        for _ in range(3):
            writer.write(torch.zeros(32, 32, 3, dtype=torch.uint8))
    track = load_track(folder)
    write_npz(replace(track, header={"side": "right", "source": str(video)}), folder / "track.npz")
    assert load_clip(folder).fps == 12.0
    assert load_clip(folder, fps=7.0).fps == 7.0


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
