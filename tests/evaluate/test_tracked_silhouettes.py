"""Silhouettes of a track against ray casts of the same hand."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from torchhand.errors import InputError
from torchhand.evaluate.tracked_silhouettes import tracked_projector, tracked_silhouettes
from torchhand.files import Track, camera_entry, load_hand_model, save_hand
from torchhand.geometry import Camera, assumed_camera, rotation_from_vector
from torchhand.hand import DOFS, place_primitives, posture, primitive_sizes
from torchhand.image import intersection_over_union
from torchhand.view import raycast

FRAMES = (4, 6, 7)
SPACE = load_hand_model().shape_space
SHAPE = SPACE.default + 0.7 * SPACE.std
CAMERA = assumed_camera(140, 110, horizontal_fov_deg=48.0)


def poses() -> Tensor:
    """Three poses in the camera frame; a hand upright, aslant and turned to its side."""
    result = torch.stack([posture(name, dtype=torch.float64) for name in ("open", "point", "fist")])
    result[:, :3] = torch.tensor((0.0, 0.06, 0.45))
    result[:, 3:6] = torch.tensor(((3.0, 0.1, 0.0), (2.8, 0.4, 0.3), (2.0, 0.5, -1.4)))
    return result


def track_of_poses(poses: Tensor, **header: Any) -> Track:
    count = len(poses)
    return Track(
        frame=np.array(FRAMES),
        status=np.array(["tracked"] * count, dtype="<U16"),
        pose=poses.numpy(),
        pose_std=np.ones((count, 36)),
        keypoints3d=np.zeros((count, 21, 3)),
        keypoints2d=np.zeros((count, 21, 2)),
        keypoints3d_cov=np.zeros((count, 21, 3, 3)),
        seconds=np.zeros(count),
        dof_names=DOFS,
        units="",
        convention="",
        header={"side": "right", "camera": camera_entry(CAMERA), **header},
    )


@pytest.fixture
def hand_file(tmp_path: Path) -> Path:
    save_hand(tmp_path / "hand.json", SPACE.names, SHAPE.tolist(), "right", {}, units=SPACE.units)
    return tmp_path / "hand.json"


def cast(pose: Tensor, side: str) -> np.ndarray:
    """The exact mask of the hand in the camera frame."""
    kinematics = load_hand_model().kinematics("left" if side == "left" else "right", dtype=torch.float64)
    frames = kinematics(pose, SHAPE, root_reference=torch.eye(3, dtype=torch.float64))
    placed = place_primitives(frames, primitive_sizes(SPACE, SHAPE), is_left=side == "left")
    return raycast(placed, CAMERA).mask.numpy()


def moved(camera: Camera) -> Camera:
    """The same camera elsewhere in the world: nothing changes for poses in its own frame."""
    turn = rotation_from_vector(torch.tensor((0.2, -0.4, 0.1), dtype=torch.float64))
    return replace(camera, rotation=turn, translation=torch.tensor((0.1, 0.2, -0.3), dtype=torch.float64))


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("camera", [CAMERA, moved(CAMERA)], ids=["at_origin", "elsewhere"])
def test_they_are_the_ray_casts_by_frame_number(side: str, camera: Camera, hand_file: Path) -> None:
    known = poses()
    track = track_of_poses(known, side=side, camera={**camera_entry(camera), "is_assumed": True})
    silhouette = tracked_silhouettes(track, tracked_projector(track, hand_file))
    for number, pose in zip(FRAMES, known, strict=True):
        drawn = silhouette(number)
        assert drawn is not None
        true = cast(pose, side)
        assert true.sum() > 500
        assert float(intersection_over_union(torch.from_numpy(drawn), torch.from_numpy(true))) > 0.96
    assert silhouette(5) is None


def test_lost_frames_have_none(hand_file: Path) -> None:
    known = poses()
    known[1] = torch.nan
    track = track_of_poses(known)
    silhouette = tracked_silhouettes(track, tracked_projector(track, hand_file))
    assert [silhouette(number) is None for number in FRAMES] == [False, True, False]


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ({"side": None}, "track: side: expected left or right, got None"),
        ({"camera": None}, "track: camera: expected an object with name, width"),
        ({"camera": {"name": "cam0"}}, "track: camera: lacks width, height"),
    ],
)
def test_a_track_without_side_or_camera_is_refused(header: dict[str, Any], message: str, hand_file: Path) -> None:
    with pytest.raises(InputError, match=message):
        tracked_projector(track_of_poses(poses(), **header), hand_file)


def test_other_degrees_of_freedom_are_refused(hand_file: Path) -> None:
    track = replace(track_of_poses(poses()), dof_names=("bend", *DOFS[1:]))
    with pytest.raises(InputError, match="track: dof_names: expected the 36 of this version's hand"):
        tracked_projector(track, hand_file)
