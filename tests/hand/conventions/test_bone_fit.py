"""Joint angles from rotations of bones: exact where joints can follow, nearest where they cannot."""

import math

import numpy as np
import pytest
import torch
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from torchhand.files import load_hand_model
from torchhand.geometry import rotation_from_vector
from torchhand.hand.conventions.bone_fit import fit_bones
from torchhand.hand.conventions.bone_turns import bone_rotations, bone_turns, turns_in_world
from torchhand.hand.kinematics import BONES, DOFS, PARENTS, HandKinematics, Side, sided_skeleton

SIDES: tuple[Side, ...] = ("right", "left")


def _kinematics(side: Side) -> HandKinematics:
    return load_hand_model().kinematics(side, dtype=torch.float64)


def _poses(count: int, generator: torch.Generator) -> torch.Tensor:
    skeleton = load_hand_model().skeleton
    fraction = torch.rand(count, 30, generator=generator, dtype=torch.float64)
    root = torch.randn(count, 6, generator=generator, dtype=torch.float64)
    return torch.cat((root, skeleton.lower + fraction * (skeleton.upper - skeleton.lower)), 1)


@pytest.mark.parametrize("side", SIDES)
def test_poses_within_the_limits_come_back(side: Side, generator: torch.Generator) -> None:
    kinematics, poses = _kinematics(side), _poses(300, generator)
    skeleton = load_hand_model().skeleton
    poses[0, 6:], poses[1, 6:], poses[2, 6:] = 0, skeleton.lower, skeleton.upper
    frames = kinematics(poses)
    fit = fit_bones(kinematics, frames.rotation, frames.position[:, 0])
    again = kinematics(fit.pose)
    assert float((again.rotation - frames.rotation).abs().max()) < 1e-12
    assert float((again.keypoints - frames.keypoints).abs().max()) < 1e-12
    assert float(fit.residual.max()) < 1e-12
    assert float((fit.pose - poses)[:, 6:].abs().max()) < 1e-9
    assert torch.equal(fit.pose[:, :3], poses[:, :3])


@pytest.mark.parametrize("bend_deg", [89.9999, 90.0, 90.0001])
def test_a_knuckle_bent_by_a_right_angle(bend_deg: float) -> None:
    """Abduction and twist turn about one line there: the bones come back, if not each angle."""
    kinematics = _kinematics("right")
    pose = torch.zeros(36, dtype=torch.float64)
    for dof, angle in (("index_mcp_fe", bend_deg), ("index_mcp_aa", 12.0), ("index_mcp_tw", -7.0)):
        pose[DOFS.index(dof)] = math.radians(angle)
    frames = kinematics(pose)
    fit = fit_bones(kinematics, frames.rotation, frames.position[0])
    assert float((kinematics(fit.pose).rotation - frames.rotation).abs().max()) < 1e-8
    assert float(fit.pose[DOFS.index("index_mcp_fe")]) == pytest.approx(math.radians(bend_deg), abs=1e-5)
    assert float(fit.pose[6:].abs().max()) < 2.0


def test_what_a_hinge_cannot_do_is_the_residual(generator: torch.Generator) -> None:
    """A joint with fewer angles comes as near as a search over them does."""
    kinematics = _kinematics("right")
    pose = _poses(1, generator)[0]
    frames = kinematics(pose)
    twist = rotation_from_vector(torch.tensor((0.05, 0.4, -0.1), dtype=torch.float64))
    for name, dofs in (("index_middle", ("index_pip_fe",)), ("thumb_proximal", ("thumb_mcp_aa", "thumb_mcp_fe"))):
        bone = BONES.index(name)
        rotation = frames.rotation.clone()
        # only this bone: those beyond it keep their place relative to it
        beyond = [b for b in range(len(BONES)) if _is_beyond(b, bone)]
        moved = frames.rotation[bone] @ twist @ frames.rotation[bone].mT
        rotation[beyond] = moved @ rotation[beyond]
        fit = fit_bones(kinematics, rotation, frames.position[0])
        others = [b for b in range(len(BONES)) if b != bone]
        assert float(fit.residual[others].max()) < 1e-9
        assert float(fit.residual[bone]) > 0.1
        wanted = rotation[PARENTS[bone]].mT @ rotation[bone]

        def distance(angles: np.ndarray, bone: int = bone, dofs: tuple = dofs, wanted: torch.Tensor = wanted) -> float:
            tried = torch.zeros(36, dtype=torch.float64)
            tried[[DOFS.index(dof) for dof in dofs]] = torch.from_numpy(angles)
            turned = kinematics(tried).rotation
            own = turned[PARENTS[bone]].mT @ turned[bone]
            return float(np.linalg.norm(Rotation.from_matrix((wanted @ own.mT).numpy()).as_rotvec()))

        start = fit.pose[[DOFS.index(dof) for dof in dofs]].numpy()
        best = minimize(distance, start + 0.2, method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-12})
        assert float(fit.residual[bone]) == pytest.approx(best.fun, abs=1e-6)
        assert start == pytest.approx(best.x, abs=1e-3)


def _is_beyond(bone: int, root: int) -> bool:
    while bone >= 0:
        if bone == root:
            return True
        bone = PARENTS[bone]
    return False


def test_any_batch_is_a_loop(generator: torch.Generator) -> None:
    kinematics, poses = _kinematics("left"), _poses(6, generator)
    frames = kinematics(poses)
    rotation = frames.rotation @ rotation_from_vector(0.1 * torch.randn(6, 20, 3, generator=generator).double())
    single = [fit_bones(kinematics, rotation[i], frames.position[i, 0]) for i in range(6)]
    many = fit_bones(kinematics, rotation.unflatten(0, (2, 3)), frames.position[:, 0].unflatten(0, (2, 3)))
    one = fit_bones(kinematics, rotation[:1], frames.position[:1, 0])
    for i, fit in enumerate(single):
        assert torch.allclose(many.pose[i // 3, i % 3], fit.pose, rtol=0, atol=1e-9)
        assert torch.allclose(many.residual[i // 3, i % 3], fit.residual, rtol=0, atol=1e-9)
    assert torch.allclose(one.pose[0], single[0].pose, rtol=0, atol=1e-9)
    assert fit_bones(kinematics, rotation[:0], frames.position[:0, 0]).pose.shape == (0, 36)
    low = fit_bones(kinematics, rotation.float(), frames.position[:, 0].float())
    assert low.pose.dtype == torch.float32
    assert torch.allclose(low.pose.double(), torch.stack([fit.pose for fit in single]), rtol=0, atol=1e-5)


@pytest.mark.parametrize("side", SIDES)
def test_turns_since_rest(side: Side, generator: torch.Generator) -> None:
    """Turns are the identity at rest, chain up to the bones' own, and come back."""
    kinematics, poses = _kinematics(side), _poses(4, generator)
    rest_pose = torch.zeros(36, dtype=torch.float64)
    rest = kinematics(rest_pose).rotation
    assert float((bone_turns(rest, rest) - torch.eye(3).double()).abs().max()) < 1e-14
    rotation = kinematics(poses).rotation
    turns = bone_turns(rotation, rest)
    bone, chain = BONES.index("ring_distal"), torch.eye(3).double()
    path = []
    while bone >= 0:
        path.append(bone)
        bone = PARENTS[bone]
    for b in reversed(path):
        chain = chain @ turns[:, b]
    assert float((chain - turns_in_world(rotation, rest)[:, path[0]]).abs().max()) < 1e-14
    assert float((bone_rotations(turns, rest) - rotation).abs().max()) < 1e-14


@pytest.mark.parametrize("side", SIDES)
def test_the_skeleton_of_a_side_and_shape_places_bones_as_kinematics_does(
    side: Side, generator: torch.Generator
) -> None:
    model = load_hand_model()
    _, shapes = model.prior(dtype=torch.float64).sample(1, generator)
    shape, pose = shapes[0].double(), _poses(1, generator)[0]
    skeleton = sided_skeleton(model.skeleton, side, space=model.shape_space, shape=shape)
    frames = _kinematics(side)(pose, shape)
    rotation, position = [rotation_from_vector(pose[3:6])], [pose[:3]]
    for bone in range(1, len(BONES)):
        parent = PARENTS[bone]
        own = sorted((d for d in range(30) if skeleton.bone[d] == bone), key=lambda d: skeleton.order[d])
        turn = skeleton.rest_rotation[bone]
        for dof in own:
            turn = turn @ rotation_from_vector(pose[6 + dof] * skeleton.axis[dof] / skeleton.axis[dof].norm())
        position.append(position[parent] + rotation[parent] @ skeleton.rest_offset[bone])
        rotation.append(rotation[parent] @ turn)
    assert float((torch.stack(rotation) - frames.rotation).abs().max()) < 1e-12
    assert float((torch.stack(position) - frames.position).abs().max()) < 1e-12
    last = BONES.index("index_distal")
    assert float((position[last] + rotation[last] @ skeleton.tip_offset[1] - frames.keypoints[8]).abs().max()) < 1e-12
