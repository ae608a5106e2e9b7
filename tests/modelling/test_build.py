"""A coarse mesh from the generic hand's own tables: what the shipped one is made of, in little."""

from dataclasses import replace

import pytest
import torch
import trimesh
from torch import Tensor

pytest.importorskip("gpytoolbox", reason="building meshes needs torchhand[build]")
pytest.importorskip("skimage", reason="building meshes needs torchhand[build]")

from torchhand.files import load_hand_model
from torchhand.hand import BONES, JOINT_DOFS, Hand, HandFrames, HandMesh, HandModel, posture
from torchhand.modelling.build import BIND_POSTURE
from torchhand.modelling.correctives import with_correctives
from torchhand.modelling.field import HandField
from torchhand.modelling.shape_basis import shape_basis, shape_of_metres
from torchhand.modelling.surface import even_mesh
from torchhand.modelling.weights import skin_weights

pytestmark = pytest.mark.slow  # making a mesh takes a quarter of a minute
VERTICES = 400
CORRECTED = ("index_pip_fe", "ring_mcp_fe", "thumb_ip_fe")
PARAMETERS = (
    "hand_length",
    "palm_breadth",
    "palm_thickness",
    "middle_proximal",
    "thumb_metacarpal",
    "index_pip_radius",
)


@pytest.fixture(scope="module")
def model() -> HandModel:
    shipped = load_hand_model()
    return HandModel(name="coarse", skeleton=shipped.skeleton, shape_space=shipped.shape_space)


@pytest.fixture(scope="module")
def built(model: HandModel) -> HandMesh:
    """The steps of `build_mesh`, with a coarse grid and some of the shape parameters and joints."""
    kinematics, space = model.kinematics(dtype=torch.float64), model.shape_space
    pose, shape = posture(BIND_POSTURE, dtype=torch.float64), kinematics.default_shape
    frames = kinematics(pose)
    points, faces = even_mesh(HandField(space, frames, shape), frames.keypoints, VERTICES, step=0.003)
    bones, weights = skin_weights(space, frames, shape, points, faces)
    basis = torch.zeros(len(points), 3, len(space.names), dtype=torch.float64)
    columns = [space.names.index(name) for name in PARAMETERS]
    basis[..., columns] = shape_basis(kinematics, pose, points, bones, weights, names=PARAMETERS)
    mesh = HandMesh(
        vertices=points,
        faces=faces,
        shape_basis=basis,
        skin_bones=bones,
        skin_weights=weights,
        bind_pose=pose,
        corrective_dofs=(),
        corrective_basis=points.new_zeros(len(points), 3, 0, 2),
    )
    return with_correctives(model, mesh, CORRECTED)


@pytest.fixture(scope="module")
def hand(model: HandModel, built: HandMesh) -> Hand:
    return replace(model, mesh=built).hand(dtype=torch.float64)


def distances(hand: Hand, frames: HandFrames, shape: Tensor, points: Tensor) -> Tensor:
    return HandField(hand.shape_space, frames, shape)(points)


def test_it_is_closed(built: HandMesh) -> None:
    assert abs(len(built.vertices) - VERTICES) <= 10
    assert trimesh.Trimesh(built.vertices.numpy(), built.faces.numpy(), process=False).is_volume


def test_its_vertices_lie_on_the_skin(hand: Hand) -> None:
    state = hand(posture("open", dtype=torch.float64))
    found = distances(hand, state.frames, hand.shape, state.vertices)
    assert float(found.abs().max()) < 2.5e-3, "a coarse mesh stands out by half of what its triangles cut off"
    assert float(found.mean()) > 0


@pytest.mark.parametrize("name", PARAMETERS)
def test_the_shape_vector_drives_it(hand: Hand, name: str) -> None:
    """Vertices of another hand lie as near to its skin as those of the default hand do to theirs."""
    space, pose, column = hand.shape_space, posture("open", dtype=torch.float64), hand.shape_space.names.index(name)
    level = distances(hand, hand.kinematics(pose), hand.shape, hand(pose).vertices)
    for sign in (1.0, -1.0):
        metres = space.metres(hand.shape)
        metres[column] += sign * metres[column].abs() * 0.06
        shape = shape_of_metres(space.names, space.units, metres)
        state = hand(pose, shape)
        moved = (state.vertices - hand(pose).vertices).norm(dim=-1)
        assert float(moved.max()) > 0.3e-3
        error = distances(hand, state.frames, shape, state.vertices) - level
        unmoved = distances(hand, state.frames, shape, hand(pose).vertices) - level
        assert float(error.abs().mean()) < 0.1 * float(unmoved.abs().mean()) + 1e-6
        assert float(error.abs().max()) < 1e-3


def test_weights_follow_the_bones(built: HandMesh, hand: Hand) -> None:
    mesh = built
    frames = hand.kinematics(mesh.bind_pose)
    heaviest = mesh.skin_bones.gather(1, mesh.skin_weights.argmax(-1, keepdim=True))[:, 0]
    for name in ("thumb_distal", "index_distal", "middle_middle", "little_proximal"):
        bone = BONES.index(name)
        on_it = heaviest == bone
        assert int(on_it.sum()) > 3
        local = (mesh.vertices[on_it] - frames.position[bone]) @ frames.rotation[bone]
        assert float(local[:, 1].min()) > -0.008, "nothing below its joint"
        assert float(local[:, [0, 2]].norm(dim=-1).max()) < 0.02, "nothing of another finger"


@pytest.mark.parametrize("dof", CORRECTED)
def test_correctives_bring_a_bent_joint_back_to_its_skin(
    model: HandModel, built: HandMesh, hand: Hand, dof: str
) -> None:
    mesh = built
    assert JOINT_DOFS.index(dof) in mesh.corrective_dofs
    bare = replace(mesh, corrective_dofs=(), corrective_basis=mesh.corrective_basis[:, :, :0])
    plain = replace(model, mesh=bare).hand(dtype=torch.float64)
    pose = mesh.bind_pose.clone()
    level = distances(hand, hand.kinematics(pose), hand.shape, mesh.vertices)
    pose[6 + JOINT_DOFS.index(dof)] += 1.2
    frames = hand.kinematics(pose)
    with_them, without = (
        (distances(hand, frames, hand.shape, h(pose).vertices) - level).square().sum() for h in (hand, plain)
    )
    assert float(with_them) < 0.4 * float(without)
