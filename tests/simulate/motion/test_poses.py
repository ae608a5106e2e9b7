"""Poses that a user writes or chance draws, as motions."""

import math

import numpy as np
import pytest
import torch

from torchhand.errors import InputError
from torchhand.files import load_hand_model
from torchhand.geometry import assumed_camera
from torchhand.hand import DOFS, posture
from torchhand.simulate.motion.poses import parse_pose, posed_motion, sampled_motion

CAMERA = assumed_camera(360, 288, horizontal_fov_deg=48.0)
MODEL = load_hand_model()
KINEMATICS = MODEL.kinematics("right", dtype=torch.float64)
INDEX = DOFS.index("index_mcp_fe")


def test_a_posture_with_changes() -> None:
    pose = parse_pose("point, index_mcp_fe=12.5 ,root_rz=-90,root_tx=30", KINEMATICS.skeleton)
    wanted = posture("point", dtype=torch.float64)
    wanted[INDEX] = math.radians(12.5)
    wanted[DOFS.index("root_rz")], wanted[0] = -math.pi / 2, 0.03
    torch.testing.assert_close(pose, wanted)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("flatt", "'flatt' is no posture.*flat.*allowed: open"),
        ("", "'' is no posture"),
        ("flat,index_mcp=10", "'index_mcp' is no degree of freedom.*index_mcp"),
        ("flat,index_mcp_fe", "expected index_mcp_fe=NUMBER, got 'index_mcp_fe'"),
        ("flat,index_mcp_fe=ten", "expected index_mcp_fe=NUMBER"),
        ("flat,index_mcp_fe=nan", "expected index_mcp_fe=NUMBER"),
        ("flat,index_pip_fe=170", "index_pip_fe: expected .* to 1.* degrees, got 170"),
    ],
)
def test_what_is_no_pose_is_named(text: str, message: str) -> None:
    with pytest.raises(InputError, match=f"--pose: {message}"):
        parse_pose(text, KINEMATICS.skeleton)


def test_poses_follow_each_other_evenly() -> None:
    poses = [parse_pose(text, KINEMATICS.skeleton) for text in ("flat", "flat,index_mcp_fe=60", "flat")]
    motion = posed_motion(poses, 5, KINEMATICS, CAMERA)
    np.testing.assert_allclose(motion.poses[:, INDEX].rad2deg(), [0, 30, 60, 30, 0], rtol=0, atol=1e-9)
    still = posed_motion(poses[1:2], 3, KINEMATICS, CAMERA)
    assert torch.equal(still.poses, still.poses[:1].expand(3, -1))
    with pytest.raises(InputError, match="--frames: expected 3 or more, one for each --pose, got 2"):
        posed_motion(poses, 2, KINEMATICS, CAMERA)


def test_turn_and_displacement_are_those_of_the_camera_about_the_middle() -> None:
    texts = ("flat", "flat,root_rz=180", "flat,root_tx=20")
    motion = posed_motion([parse_pose(text, KINEMATICS.skeleton) for text in texts], 3, KINEMATICS, CAMERA)
    points = KINEMATICS(motion.poses, root_reference=motion.root_reference).keypoints
    middle = CAMERA.cam_from_world(points[0, [0, 12]]).mean(0)
    turned, moved = (CAMERA.cam_from_world(points[i]) - CAMERA.cam_from_world(points[0]) for i in (1, 2))
    assert float((turned[0, :2] - 2 * (middle - CAMERA.cam_from_world(points[0]))[0, :2]).norm()) < 0.01
    wanted = torch.tensor((0.02, 0.0, 0.0), dtype=torch.float64).expand(21, -1)
    torch.testing.assert_close(moved, wanted, rtol=0, atol=1e-12)


def test_sampled_poses_are_unrelated_within_the_limits_and_seeded() -> None:
    def drawn(seed: int, turn_deg: float) -> torch.Tensor:
        generator = torch.Generator().manual_seed(seed)
        return sampled_motion(
            MODEL.prior(dtype=torch.float64), 40, KINEMATICS, CAMERA, generator, turn_deg=turn_deg
        ).poses

    poses = drawn(3, 30.0)
    joints = poses[:, 6:]
    torch.testing.assert_close(joints, KINEMATICS.skeleton.within_limits(joints))
    turns = poses[:, 3:6].norm(dim=-1).rad2deg()
    assert 20 < float(turns.max()) <= 30 + 1e-9
    assert float(joints.diff(dim=0).abs().amax(-1).min()) > math.radians(3)
    assert torch.equal(poses, drawn(3, 30.0))
    assert not torch.equal(poses, drawn(4, 30.0))
    assert float(drawn(3, 0.0)[:, 3:6].abs().max()) == 0
