"""A coarse mesh from the generic hand's own tables: what the shipped one is made of, in little."""

import pytest
import torch
import trimesh
from torch import Tensor

pytest.importorskip("gpytoolbox", reason="building meshes needs torchhand[build]")
pytest.importorskip("skimage", reason="building meshes needs torchhand[build]")

from torchhand.files import load_hand_model
from torchhand.hand import BONES, JOINT_DOFS, HandFrames, posture
from torchhand.hand.hand import Hand
from torchhand.hand.mesh import HandMesh
from torchhand.hand.model import HandModel
from torchhand.modelling.build import build_mesh, build_steps
from torchhand.modelling.field import HandField
from torchhand.simulate import sample_shape

VERTICES = 400


@pytest.fixture(scope="module")
def model() -> HandModel:
    shipped = load_hand_model()
    return HandModel(name="coarse", skeleton=shipped.skeleton, shape_space=shipped.shape_space)


@pytest.fixture(scope="module")
def built(model: HandModel) -> tuple[HandMesh, int]:
    steps = []
    mesh = build_mesh(model, vertices=VERTICES, grid=0.003, on_step=steps.append)
    return mesh, sum(steps)


@pytest.fixture(scope="module")
def hand(model: HandModel, built: tuple[HandMesh, int]) -> Hand:
    whole = HandModel(name="coarse", skeleton=model.skeleton, shape_space=model.shape_space, mesh=built[0])
    return whole.hand(dtype=torch.float64)


def distances(hand: Hand, frames: HandFrames, shape: Tensor, points: Tensor) -> Tensor:
    return HandField(hand.shape_space, frames, shape)(points)


def test_it_is_closed_and_reports_its_steps(model: HandModel, built: tuple[HandMesh, int]) -> None:
    mesh, steps = built
    assert abs(len(mesh.vertices) - VERTICES) <= 10
    assert trimesh.Trimesh(mesh.vertices.numpy(), mesh.faces.numpy(), process=False).is_volume
    assert steps == build_steps(model)


def test_its_vertices_lie_on_the_skin(hand: Hand) -> None:
    state = hand(posture("open"))
    found = distances(hand, state.frames, hand.shape, state.vertices)
    assert float(found.abs().max()) < 2.5e-3, "a coarse mesh stands out by half of what its triangles cut off"
    assert float(found.mean()) > 0


def test_the_shape_vector_drives_it(hand: Hand, generator: torch.Generator) -> None:
    """Vertices of other people lie as near to their own skins as those of the default hand to its."""
    space = hand.shape_space
    pose = posture("open")
    at_default = distances(hand, hand.kinematics(pose), hand.shape, hand(pose).vertices)
    for _ in range(4):
        shape = sample_shape(space, generator).double()
        state = hand(pose, shape)
        error = distances(hand, state.frames, shape, state.vertices) - at_default
        moved = (state.vertices - hand(pose).vertices).norm(dim=-1)
        assert float(error.abs().median()) < 0.2e-3
        assert float(error.abs().quantile(0.95)) < 0.15 * float(moved.max())


def test_weights_follow_the_bones(built: tuple[HandMesh, int], hand: Hand) -> None:
    mesh = built[0]
    frames = hand.kinematics(mesh.bind_pose)
    heaviest = mesh.skin_bones.gather(1, mesh.skin_weights.argmax(-1, keepdim=True))[:, 0]
    for name in ("thumb_distal", "index_distal", "middle_middle", "little_proximal"):
        bone = BONES.index(name)
        on_it = heaviest == bone
        assert int(on_it.sum()) > 3
        local = (mesh.vertices[on_it] - frames.position[bone]) @ frames.rotation[bone]
        assert float(local[:, 1].min()) > -0.008, "nothing below its joint"
        assert float(local[:, [0, 2]].norm(dim=-1).max()) < 0.02, "nothing of another finger"


@pytest.mark.parametrize("dof", ["index_pip_fe", "ring_mcp_fe", "thumb_ip_fe"])
def test_correctives_bring_a_bent_joint_back_to_its_skin(built: tuple[HandMesh, int], hand: Hand, dof: str) -> None:
    mesh = built[0]
    assert JOINT_DOFS.index(dof) in mesh.corrective_dofs
    bare = HandMesh(**{**vars(mesh), "corrective_dofs": (), "corrective_basis": mesh.corrective_basis[:, :, :0]})
    model = HandModel(name="bare", skeleton=hand.kinematics.skeleton, shape_space=hand.shape_space, mesh=bare)
    plain = model.hand(dtype=torch.float64)
    pose = mesh.bind_pose.clone()
    level = distances(hand, hand.kinematics(pose), hand.shape, mesh.vertices)
    pose[6 + JOINT_DOFS.index(dof)] += 1.2
    frames = hand.kinematics(pose)
    with_them, without = (
        (distances(hand, frames, hand.shape, h(pose).vertices) - level).square().sum() for h in (hand, plain)
    )
    assert float(with_them) < 0.4 * float(without)
