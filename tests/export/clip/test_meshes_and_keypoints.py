"""OBJ and PLY through trimesh; keypoints through our readers of detections, and numpy; tables through csv."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from torchhand.errors import InputError
from torchhand.export.clip.angle_file import write_angles
from torchhand.export.clip.keypoint_file import write_keypoints
from torchhand.export.clip.mesh_frames import write_mesh_frames
from torchhand.export.clip.motion_clip import MotionClip
from torchhand.files import read_detections
from torchhand.hand import DOFS, FINGERS, JOINT_DOFS, KEYPOINTS


@pytest.mark.parametrize(("suffix", "rounding"), [("obj", 1e-9), ("ply", 1e-7)])
def test_one_file_per_frame_named_after_it(clip: MotionClip, tmp_path: Path, suffix: str, rounding: float) -> None:
    later = replace(clip, frame=tuple(range(12, 19)))
    paths = write_mesh_frames(later, tmp_path / f"hand.{suffix}")
    assert [path.name for path in paths] == [f"hand_{number:06d}.{suffix}" for number in range(12, 19)]
    assert sorted(tmp_path.iterdir()) == paths
    for path, vertices in zip(paths, clip.vertices().numpy(), strict=True):
        mesh = trimesh.load_mesh(path, process=False)
        assert isinstance(mesh, trimesh.Trimesh)
        assert np.abs(mesh.vertices - vertices).max() < rounding
        assert mesh.faces.tolist() == clip.hand.faces.tolist()
        assert mesh.is_watertight
        assert mesh.volume > 1e-4


def test_a_single_frame_keeps_the_name(still: MotionClip, tmp_path: Path) -> None:
    assert write_mesh_frames(still, tmp_path / "hand.obj") == [tmp_path / "hand.obj"]
    assert [path.name for path in tmp_path.iterdir()] == ["hand.obj"]


@pytest.mark.parametrize("name", ["hand.keypoints.json", "hand.npz", "hand.npy"])
def test_keypoints_read_back(clip: MotionClip, tmp_path: Path, name: str) -> None:
    later = replace(clip, frame=tuple(range(12, 19)))
    write_keypoints(later, tmp_path / name)
    found = read_detections(tmp_path / name)
    assert np.array_equal(found.keypoints, clip.frames.keypoints.numpy())
    assert found.units == "metres"
    if not name.endswith("npy"):
        assert found.frame.tolist() == list(range(12, 19))
        assert found.side == clip.side


def test_keypoints_as_a_table(clip: MotionClip, tmp_path: Path) -> None:
    write_keypoints(clip, tmp_path / "hand.csv")
    with (tmp_path / "hand.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["frame"]) for row in rows] == list(range(7))
    assert [float(row["time"]) for row in rows] == [t / 25 for t in range(7)]
    points = [[[float(row[f"{name}_{axis}"]) for axis in "xyz"] for name in KEYPOINTS] for row in rows]
    assert np.array_equal(np.array(points), clip.frames.keypoints.numpy())


def test_the_file_is_in_the_form_of_mediapipe(clips: dict[str, MotionClip], tmp_path: Path) -> None:
    """MediaPipe calls the hand of a picture that is not mirrored by the other side's name."""
    write_keypoints(clips["right"], tmp_path / "hand.json")
    frame = json.loads((tmp_path / "hand.json").read_text())["frames"][3]
    assert frame["frame"] == 3
    assert frame["handedness"][0][0]["categoryName"] == "Left"
    assert set(frame["hand_world_landmarks"][0][20]) == {"x", "y", "z"}


def test_other_endings_are_refused(clip: MotionClip, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"expected keypoints as one of .json, .npz, .npy, .csv, got '.txt'"):
        write_keypoints(clip, tmp_path / "hand.txt")


def test_angles_as_a_table_with_what_is_known_of_each(clip: MotionClip, tmp_path: Path) -> None:
    """Lost frames keep their line, with no number that was not measured."""
    std = torch.deg2rad(torch.arange(36, dtype=torch.float64)).expand(7, -1).clone()
    status = ("tracked",) * 3 + ("lost",) + ("recovered",) + ("tracked",) * 2
    quality = torch.arange(35, dtype=torch.float64).reshape(7, 5) / 35
    clip = replace(clip, pose_std=std, finger_quality=quality, status=status, held=(3,))
    write_angles(clip, tmp_path / "angles.csv")
    assert not set((tmp_path / "angles.csv").read_text()) & set('"#;\t')  # one plain table, no comment before it
    with (tmp_path / "angles.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["status"] for row in rows] == list(status)
    assert [float(row["time_s"]) for row in rows] == [t / 25 for t in range(7)]
    for t, row in enumerate(rows):
        told = [row[f"{finger}_quality"] for finger in FINGERS]
        assert told == ([""] * 5 if t == 3 else [f"{value:.4f}" for value in quality[t].tolist()])
        for name in JOINT_DOFS:
            value, spread = row[f"{name}_deg"], row[f"{name}_std_deg"]
            if t == 3:
                assert (value, spread) == ("", "")
            else:
                assert float(value) == pytest.approx(float(torch.rad2deg(clip.poses[t, DOFS.index(name)])), abs=1e-4)
                assert float(spread) == pytest.approx(DOFS.index(name), abs=1e-4)


def test_angles_of_a_clip_without_its_gaps_keep_their_times(clip: MotionClip, tmp_path: Path) -> None:
    cut = replace(clip, frame=(4, 5, 6, 9, 10, 11, 20))
    write_angles(cut, tmp_path / "angles.csv")
    with (tmp_path / "angles.csv").open(newline="") as file:
        times = [float(row["time_s"]) for row in csv.DictReader(file)]
    assert times == [(number - 4) / 25 for number in cut.frame]
