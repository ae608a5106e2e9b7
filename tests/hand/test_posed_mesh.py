"""The posed skin as plain triangles."""

import pytest
import torch

from torchhand.files import load_hand_model
from torchhand.geometry import rotation_from_vector
from torchhand.hand.kinematics import BONES, posture
from torchhand.hand.posed_mesh import PosedMesh, posed_mesh

HAND = load_hand_model().hand(dtype=torch.float64)


def _flat(*batch: int) -> PosedMesh:
    return posed_mesh(HAND, HAND(posture("flat", dtype=torch.float64).expand(*batch, -1)))


def test_every_face_goes_with_the_bone_nearest_to_it() -> None:
    """Of a flat hand: fingertips' faces are their distal bones', and no bone is without faces."""
    mesh = _flat()
    state = HAND(posture("flat", dtype=torch.float64))
    centres = mesh.vertices[mesh.faces].mean(1)
    for finger, tip in (("thumb", 4), ("index", 8), ("little", 20)):
        nearest = (centres - state.keypoints[tip]).norm(dim=-1).argsort()[:20]
        assert {BONES[int(part)] for part in mesh.part_of_face[nearest]} == {f"{finger}_distal"}
    assert {"middle_proximal", "middle_middle", "middle_distal"} <= {BONES[i] for i in mesh.part_of_face.unique()}


def test_normals_point_outwards() -> None:
    """They are unit, and following them a little makes the hand larger."""
    mesh = _flat()
    normals = mesh.vertex_normals()
    torch.testing.assert_close(normals.norm(dim=-1), torch.ones(len(normals), dtype=torch.float64))

    def volume(vertices: torch.Tensor) -> float:
        a, b, c = vertices[mesh.faces].unbind(1)
        return float((a * torch.linalg.cross(b, c)).sum() / 6)

    area = float(torch.linalg.cross(*(mesh.vertices[mesh.faces].diff(dim=1)).unbind(1)).norm(dim=-1).sum()) / 2
    growth = (volume(mesh.vertices + 1e-5 * normals) - volume(mesh.vertices - 1e-5 * normals)) / 2e-5
    assert growth == pytest.approx(area, rel=0.03)


def test_batches_equal_a_loop(generator: torch.Generator) -> None:
    poses = posture("flat", dtype=torch.float64) + 0.2 * torch.randn(2, 3, 36, generator=generator, dtype=torch.float64)
    whole = posed_mesh(HAND, HAND(poses))
    for i in range(2):
        for j in range(3):
            alone = posed_mesh(HAND, HAND(poses[i, j]))
            torch.testing.assert_close(whole.select(i).select(j).vertices, alone.vertices)
            torch.testing.assert_close(whole.vertex_normals()[i, j], alone.vertex_normals())


def test_moved(generator: torch.Generator) -> None:
    mesh = _flat(2)
    vector, shift = torch.randn(2, 3, generator=generator, dtype=torch.float64)
    turn = rotation_from_vector(vector)
    moved = mesh.moved(turn, shift)
    torch.testing.assert_close(moved.vertices[1, 7], turn @ mesh.vertices[1, 7] + shift)
    torch.testing.assert_close(moved.vertex_normals(), mesh.vertex_normals() @ turn.T)
