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
from torchhand.export.clip.texture import texture_atlas
from torchhand.files import read_detections
from torchhand.geometry import rotation_from_vector
from torchhand.hand import DOFS, FINGERS, JOINT_DOFS, KEYPOINTS, HandModel
from torchhand.hand.conventions import mano_from_hand


@pytest.mark.parametrize(("suffix", "rounding"), [("obj", 1e-9), ("ply", 1e-7)])
def test_one_file_per_frame_named_after_it(clip: MotionClip, tmp_path: Path, suffix: str, rounding: float) -> None:
    later = replace(clip, frame=tuple(range(12, 19)))
    paths = write_mesh_frames(later, tmp_path / f"hand.{suffix}")
    assert [path.name for path in paths] == [f"hand_{number:06d}.{suffix}" for number in range(12, 19)]
    assert sorted(tmp_path.iterdir()) == paths
    for path, vertices in zip(paths, clip.vertices().numpy(), strict=True):
        mesh = trimesh.load_mesh(path, process=False)
        assert isinstance(mesh, trimesh.Trimesh)
        assert np.abs(mesh.triangles - vertices[clip.hand.faces.numpy()]).max() < rounding
        normals = mesh.vertex_normals[mesh.faces].reshape(-1, 3)
        outwards = mesh.face_normals.repeat(3, 0)
        assert np.median((normals * outwards).sum(-1)) > 0.95
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        assert mesh.is_watertight
        assert mesh.volume > 1e-4


def test_textures_cover_the_skin_without_overlap(model: HandModel) -> None:
    """Corners stay within the picture; texture triangles of one chart hardly lie over one another."""
    atlas = texture_atlas(model)
    assert float(atlas.uv.min()) > 0
    assert float(atlas.uv.max()) < 1
    assert torch.equal(atlas.vertex[atlas.corners], model.hand(dtype=torch.float64).faces)
    a, b, c = (atlas.uv[atlas.corners[:, i]] for i in range(3))
    area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    assert float((area < 0).double().mean()) < 0.02  # turned over: hardly any, and one way round in both charts
    assert 0.2 < float(area.sum()) < 1.0


def test_held_frames_say_so(clip: MotionClip, tmp_path: Path) -> None:
    held = replace(clip, held=(2, 5))
    for suffix in ("obj", "ply"):
        paths = write_mesh_frames(held, tmp_path / f"hand.{suffix}")
        told = [b"lost" in path.read_bytes()[:400] for path in paths]
        assert told == [False, False, True, False, False, True, False]
        assert trimesh.load_mesh(paths[2], process=False).volume > 1e-4
    write_keypoints(held, tmp_path / "hand.npz")
    assert np.flatnonzero(np.load(tmp_path / "hand.npz")["held"]).tolist() == [2, 5]
    write_keypoints(held, tmp_path / "hand.csv")
    with (tmp_path / "hand.csv").open(newline="") as file:
        assert [row["held"] for row in csv.DictReader(file)] == list("0010010")


def test_covariances_go_with_the_keypoints(clip: MotionClip, tmp_path: Path) -> None:
    """In other axes they are turned as the points are: a spread along a line of sight stays along it."""
    sight = torch.nn.functional.normalize(clip.frames.keypoints, dim=-1)
    cov = 1e-4 * sight[..., :, None] * sight[..., None, :] + 1e-6 * torch.eye(3, dtype=torch.float64)
    known = replace(clip, keypoints_cov=cov)
    write_keypoints(known, tmp_path / "hand.npz")
    assert np.array_equal(np.load(tmp_path / "hand.npz")["cov3d"], cov.numpy())
    write_keypoints(replace(known, axes="mano"), tmp_path / "mano.npz")
    stored = np.load(tmp_path / "mano.npz")
    turn = rotation_from_vector(clip.poses[:, 3:6])[:, None]
    own = sight @ turn.squeeze(1) @ mano_from_hand(clip.side).mT
    variance = np.einsum("tki,tkij,tkj->tk", own.numpy(), stored["cov3d"], own.numpy())
    assert np.abs(variance - 1.01e-4).max() < 1e-12
    write_keypoints(known, tmp_path / "hand.csv")
    with (tmp_path / "hand.csv").open(newline="") as file:
        row = list(csv.DictReader(file))[4]
    assert float(row["index_tip_xz"]) == float(cov[4, KEYPOINTS.index("index_tip"), 0, 2])


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
    assert [float(row["time_s"]) for row in rows] == [t / 25 for t in range(7)]
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
