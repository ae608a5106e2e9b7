"""MANO's joints and axes, and poses there and back."""

import math

import pytest
import torch

from torchhand.files import load_hand_model
from torchhand.hand.conventions.mano import (
    MANO_BONES,
    MANO_JOINTS,
    MANO_PARENTS,
    mano_from_hand,
    mano_of_pose,
    pose_of_mano,
    rest_rotations,
)
from torchhand.hand.kinematics import BONES, DOFS, HandKinematics, Side

SIDES: tuple[Side, ...] = ("right", "left")
PALM = [i for i, dof in enumerate(DOFS) if dof.endswith("cmc_fe") and not dof.startswith("thumb")]


def _kinematics(side: Side) -> HandKinematics:
    return load_hand_model().kinematics(side, dtype=torch.float64)


def _poses(count: int, generator: torch.Generator) -> torch.Tensor:
    skeleton = load_hand_model().skeleton
    fraction = torch.rand(count, 30, generator=generator, dtype=torch.float64)
    root = torch.randn(count, 6, generator=generator, dtype=torch.float64)
    return torch.cat((root, skeleton.lower + fraction * (skeleton.upper - skeleton.lower)), 1)


def test_order_of_the_joints() -> None:
    """Order of MANO: wrist, index, middle, little, ring, thumb."""
    assert MANO_JOINTS[:5] == ("wrist", "index1", "index2", "index3", "middle1")
    assert (MANO_JOINTS[7], MANO_JOINTS[10], MANO_JOINTS[13]) == ("little1", "ring1", "thumb1")
    assert [BONES[MANO_BONES[i]] for i in (1, 3, 7, 12, 13, 15)] == [
        *("index_proximal", "index_distal", "little_proximal"),
        *("ring_distal", "thumb_metacarpal", "thumb_distal"),
    ]
    assert MANO_PARENTS == (-1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14)


@pytest.mark.parametrize("side", SIDES)
def test_axes_of_mano(side: Side) -> None:
    """Bending turns about +z of a right hand and -z of a left one (left = towards the parent × up)."""
    axes = mano_from_hand(side)
    assert float(torch.det(axes)) == pytest.approx(1.0, abs=1e-15)
    towards_fingers, back = axes @ torch.tensor((0.0, 1, 0)).double(), axes @ torch.tensor((1.0, 0, 0)).double()
    assert towards_fingers.tolist() == ([-1, 0, 0] if side == "right" else [1, 0, 0])
    assert back.tolist() == [0, 1, 0]
    pose = torch.zeros(36, dtype=torch.float64)
    pose[DOFS.index("middle_pip_fe")] = 0.7
    mano = mano_of_pose(_kinematics(side), pose)
    expected = 0.7 if side == "right" else -0.7
    assert mano.axis_angle[5].tolist() == pytest.approx([0, 0, expected], abs=1e-12)
    others = [i for i in range(1, 16) if i != 5]
    assert float(mano.axis_angle[others].abs().max()) < 1e-12


@pytest.mark.parametrize("side", SIDES)
def test_poses_there_and_back(side: Side, generator: torch.Generator) -> None:
    kinematics, poses = _kinematics(side), _poses(100, generator)
    poses[:, PALM] = 0
    mano = mano_of_pose(kinematics, poses)
    fit = pose_of_mano(kinematics, mano.axis_angle, mano.wrist)
    assert float((fit.pose - poses)[:, 6:].abs().max()) < 1e-9
    assert float((kinematics(fit.pose).keypoints - kinematics(poses).keypoints).abs().max()) < 1e-12
    assert float(fit.residual.max()) < 1e-12
    assert float(mano.residual.max()) < 1e-12


def test_a_bent_palm_moves_the_knuckles_only(generator: torch.Generator) -> None:
    kinematics, poses = _kinematics("right"), _poses(20, generator)
    poses[:, PALM] = load_hand_model().skeleton.upper[[p - 6 for p in PALM]]
    mano = mano_of_pose(kinematics, poses)
    back = kinematics(pose_of_mano(kinematics, mano.axis_angle, mano.wrist).pose)
    ours = kinematics(poses)
    bones = list(MANO_BONES)
    assert float((back.rotation[:, bones] - ours.rotation[:, bones]).abs().max()) < 1e-12
    assert torch.allclose((back.keypoints - ours.keypoints).norm(dim=-1), mano.residual, rtol=0, atol=1e-12)
    little_lever = float(
        (ours.position[0, BONES.index("little_proximal")] - ours.position[0, BONES.index("little_metacarpal")]).norm()
    )
    expected = 2 * little_lever * math.sin(0.5 * math.radians(25))
    assert float(mano.residual[:, 17].max()) == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize("side", SIDES)
def test_rotations_that_our_joints_cannot_do(side: Side, generator: torch.Generator) -> None:
    """A phalanx twisted about itself: nothing of it is found, all of it is reported."""
    kinematics = _kinematics(side)
    local = torch.zeros(16, 3, dtype=torch.float64)
    local[2, 0] = 0.3  # index2 about the finger
    fit = pose_of_mano(kinematics, local, torch.zeros(3).double())
    bone = BONES.index("index_middle")
    assert float(fit.residual[bone]) == pytest.approx(0.3, abs=0.005)
    assert float(fit.residual[[b for b in range(20) if b != bone]].max()) < 1e-6
    knuckle = torch.zeros(16, 3, dtype=torch.float64)
    knuckle[1, 0] = 0.3
    assert float(pose_of_mano(kinematics, knuckle, torch.zeros(3).double()).residual.max()) < 1e-9


def test_another_rest_posture(generator: torch.Generator) -> None:
    kinematics, poses = _kinematics("right"), _poses(5, generator)
    poses[:, PALM] = 0
    mesh = load_hand_model().mesh
    assert mesh is not None
    rest = mesh.bind_pose
    at_rest = mano_of_pose(kinematics, rest, rest=rest)
    assert float(at_rest.axis_angle[1:].abs().max()) < 1e-12
    mano = mano_of_pose(kinematics, poses, rest=rest)
    back = pose_of_mano(kinematics, mano.axis_angle, mano.wrist, rest=rest)
    assert float((back.pose - poses)[:, 6:].abs().max()) < 1e-9
    assert float((mano.axis_angle - mano_of_pose(kinematics, poses).axis_angle).abs().max()) > 0.1
    assert rest_rotations(kinematics, rest).shape == (20, 3, 3)


def test_any_batch_is_a_loop(generator: torch.Generator) -> None:
    kinematics, poses = _kinematics("left"), _poses(6, generator)
    many = mano_of_pose(kinematics, poses.unflatten(0, (2, 3)))
    back = pose_of_mano(kinematics, many.axis_angle, many.wrist)
    for i in range(6):
        one = mano_of_pose(kinematics, poses[i])
        assert torch.allclose(many.axis_angle[i // 3, i % 3], one.axis_angle, rtol=0, atol=1e-12)
        assert torch.allclose(many.residual[i // 3, i % 3], one.residual, rtol=0, atol=1e-12)
        own = pose_of_mano(kinematics, one.axis_angle, one.wrist)
        assert torch.allclose(back.pose[i // 3, i % 3], own.pose, rtol=0, atol=1e-9)
