"""From a field to an even mesh."""

import math

import pytest
import torch
import trimesh
from torch import Tensor

pytest.importorskip("gpytoolbox", reason="building meshes needs torchhand[build]")
pytest.importorskip("skimage", reason="building meshes needs torchhand[build]")

from torchhand.modelling.diffusion import Diffusion
from torchhand.modelling.surface import even_mesh, isosurface, projected

RADIUS = 0.02


def ball(points: Tensor) -> Tensor:
    return points.norm(dim=-1) - RADIUS


CORNERS = torch.tensor([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]], dtype=torch.float64) * 0.004


def test_the_isosurface_of_a_ball() -> None:
    vertices, faces = isosurface(ball, *(CORNERS * 7).unbind(0), step=0.0015)
    body = trimesh.Trimesh(vertices.numpy(), faces.numpy(), process=False)
    assert body.is_watertight
    assert body.volume == pytest.approx(4 / 3 * math.pi * RADIUS**3, rel=0.01), "and faces look outward"


def test_an_even_mesh_of_a_ball() -> None:
    vertices, faces = even_mesh(ball, CORNERS, 400)
    assert abs(len(vertices) - 400) <= 10
    body = trimesh.Trimesh(vertices.numpy(), faces.numpy(), process=False)
    assert body.is_watertight
    assert body.edges_unique_length.std() / body.edges_unique_length.mean() < 0.15
    corners, middles = ball(vertices), ball(vertices[faces].mean(1))
    assert float(corners.mean()) == pytest.approx(-float(middles.mean()), abs=2e-5), "the surface lies between"
    assert float(corners.std()) < 2e-5
    again, same_faces = even_mesh(ball, CORNERS, 400)
    assert torch.equal(vertices, again)
    assert torch.equal(faces, same_faces)


def test_projection_finds_the_level(generator: torch.Generator) -> None:
    points = RADIUS * (0.9 + 0.2 * torch.rand(50, 1, generator=generator, dtype=torch.float64))
    points = points * torch.nn.functional.normalize(
        torch.randn(50, 3, generator=generator, dtype=torch.float64), dim=-1
    )
    level = 1e-3 * torch.rand(50, generator=generator, dtype=torch.float64)
    found = projected(ball, points, level)
    torch.testing.assert_close(ball(found), level, atol=1e-9, rtol=0)
    torch.testing.assert_close(
        torch.nn.functional.normalize(found, dim=-1), torch.nn.functional.normalize(points, dim=-1), atol=1e-9, rtol=0
    )


def test_heat_flow_keeps_constants_and_range() -> None:
    vertices, faces = even_mesh(ball, CORNERS, 400)
    diffuse = Diffusion(vertices, faces)
    ones = torch.ones(len(vertices), dtype=torch.float64)
    torch.testing.assert_close(diffuse(ones, 0.005), ones, atol=1e-9, rtol=0)
    half = (vertices[:, 0] > 0).double()
    spread = diffuse(half, 0.005)
    assert -1e-6 < float(spread.min()) < 0.1
    assert 0.9 < float(spread.max()) < 1 + 1e-6
    assert float(spread[vertices[:, 0].abs() < 0.001].std()) < 0.15, "half way at the border"
    assert float(spread[vertices[:, 0].abs() < 0.001].mean()) == pytest.approx(0.5, abs=0.1)
    torch.testing.assert_close(diffuse(torch.stack((half, ones), -1), 0.005)[:, 0], spread, atol=0, rtol=0)
