"""The shipped mesh: closed, even, smooth, true to the primitives, and sound when the hand bends."""

from dataclasses import replace

import pytest
import torch
import trimesh
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.geometry import assumed_camera
from torchhand.hand.hand import Hand
from torchhand.hand.kinematics import BONES, posture
from torchhand.hand.posed_mesh import posed_mesh
from torchhand.hand.skin import HandMesh
from torchhand.view import silhouette


@pytest.fixture(scope="module")
def hand() -> Hand:
    return load_hand_model().hand(dtype=torch.float64)


@pytest.fixture(scope="module")
def mesh() -> HandMesh:
    mesh = load_hand_model().mesh
    assert mesh is not None
    return mesh


def solid(vertices: Tensor, faces: Tensor) -> trimesh.Trimesh:
    return trimesh.Trimesh(vertices.numpy(), faces.numpy(), process=False)


def test_it_is_closed_and_consistently_oriented(mesh: HandMesh) -> None:
    assert abs(len(mesh.vertices) - 2000) <= 50
    body = solid(mesh.vertices, mesh.faces)
    assert body.is_watertight
    assert body.is_winding_consistent
    assert body.euler_number == 2, "one body without holes"
    assert 2e-4 < body.volume < 4e-4, "faces look outward, and a hand holds 0.2 to 0.4 litres"


def test_its_triangles_are_even(mesh: HandMesh) -> None:
    body = solid(mesh.vertices, mesh.faces)
    edges = torch.from_numpy(body.edges_unique_length.copy())
    assert float(edges.std() / edges.mean()) < 0.15
    assert float(edges.max() / edges.min()) < 3
    angles = torch.rad2deg(torch.from_numpy(body.face_angles.copy()))
    assert float(angles.min()) > 20
    assert float(angles.amin(-1).median()) > 45


def crossings(vertices: Tensor, faces: Tensor) -> int:
    """Pairs of triangles without a common corner of which one's edge pierces the other (Möller and Trumbore)."""
    corners = vertices[faces]
    low, high = corners.amin(1), corners.amax(1)
    are_disjoint = ((low[:, None] > high) | (low > high[:, None])).any(-1)
    first, second = (~are_disjoint).triu(1).nonzero().unbind(-1)
    strangers = ~(faces[first][:, :, None] == faces[second][:, None]).any(-1).any(-1)
    first, second = first[strangers], second[strangers]
    found = torch.zeros(len(first), dtype=torch.bool)
    for one, other in ((first, second), (second, first)):
        a, b, c = corners[other].unbind(1)
        for i in range(3):
            start, edge = corners[one][:, i], corners[one][:, (i + 1) % 3] - corners[one][:, i]
            across = torch.linalg.cross(edge, c - a)
            slope = ((b - a) * across).sum(-1)
            inverse = 1 / torch.where(slope.abs() < 1e-30, torch.inf, slope)
            offset = start - a
            u = (offset * across).sum(-1) * inverse
            turned = torch.linalg.cross(offset, b - a)
            v, t = (edge * turned).sum(-1) * inverse, ((c - a) * turned).sum(-1) * inverse
            found |= (u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0) & (t <= 1) & (slope.abs() >= 1e-30)
    return int(found.sum())


def test_crossings_are_found() -> None:
    ball = trimesh.creation.icosphere(subdivisions=2)
    points, faces = torch.from_numpy(ball.vertices.copy()), torch.from_numpy(ball.faces.copy())
    assert crossings(points, faces) == 0
    both = torch.cat((points, points + 0.8)), torch.cat((faces, faces + len(points)))
    assert crossings(*both) > 10


@pytest.mark.parametrize("name", ["open", "flat"])
def test_it_does_not_cross_itself_at_rest(hand: Hand, name: str) -> None:
    assert crossings(hand(posture(name, dtype=torch.float64)).vertices, hand.faces) == 0


def test_its_weights_are_smooth(mesh: HandMesh) -> None:
    weights = torch.zeros(len(mesh.vertices), len(BONES), dtype=torch.float64)
    weights.scatter_add_(1, mesh.skin_bones, mesh.skin_weights)
    torch.testing.assert_close(weights.sum(-1), torch.ones(len(weights), dtype=torch.float64), atol=1e-6, rtol=0)
    assert float(weights.min()) >= 0
    body = solid(mesh.vertices, mesh.faces)
    a, b = torch.from_numpy(body.edges_unique.copy()).unbind(-1)
    steps = (weights[a] - weights[b]).abs().amax(-1)
    assert float(steps.max()) < 0.75, "no seam"
    assert float(steps.quantile(0.95)) < 0.5
    carried = weights.sum(0)
    assert float(carried.min()) > 5, "every bone carries some skin"


@pytest.mark.parametrize("name", ["fist", "point", "pinch", "flat"])
def test_bending_keeps_the_volume(hand: Hand, name: str) -> None:
    rest, bent = (
        solid(hand(posture(pose, dtype=torch.float64)).vertices, hand.faces).volume for pose in ("open", name)
    )
    assert abs(bent / rest - 1) < 0.05


def test_the_correctives_are_what_keeps_it(hand: Hand) -> None:
    model = load_hand_model()
    assert model.mesh is not None
    bare = replace(model.mesh, corrective_basis=torch.zeros_like(model.mesh.corrective_basis))
    plain = replace(model, mesh=bare).hand(dtype=torch.float64)
    rest, bent, collapsed = (
        solid(h(posture(pose, dtype=torch.float64)).vertices, hand.faces).volume
        for h, pose in ((hand, "open"), (hand, "fist"), (plain, "fist"))
    )
    assert abs(collapsed / rest - 1) > 1.5 * abs(bent / rest - 1)


def test_its_silhouettes_are_those_of_the_primitives(hand: Hand, generator: torch.Generator) -> None:
    """Over 100 people and postures of the prior, each seen from a random side."""
    model = load_hand_model()
    prior = model.prior(dtype=torch.float64)
    poses, shapes = (x.double() for x in prior.sample(100, generator))
    poses[:, 3:6] = 1.5 * torch.randn(100, 3, generator=generator, dtype=torch.float64)
    camera = assumed_camera(200, 200, horizontal_fov_deg=25.0)
    overlaps = []
    for pose, shape in zip(poses, shapes, strict=True):
        state = hand(pose, shape)
        shift = torch.tensor((0.0, 0.0, 0.6), dtype=torch.float64) - state.keypoints.mean(0)
        surfaces = (state.primitives, posed_mesh(hand, state))
        a, b = (silhouette(s.moved(torch.eye(3, dtype=torch.float64), shift), camera) for s in surfaces)
        overlaps.append(float((a & b).sum() / (a | b).sum()))
    found = torch.tensor(overlaps)
    assert float(found.mean()) >= 0.96
    assert float(found.quantile(0.05)) >= 0.92
