"""Points on a hull's surface and vertices spread over the skin."""

from typing import Any

import pytest
import torch
from torch import Tensor

from torchhand.fit.hull.points import hull_target, spread_vertices, target_of
from torchhand.hand import posture


class Capsule:
    """From the origin along x."""

    def __init__(self, length: float = 0.1, radius: float = 0.02) -> None:
        self.length, self.radius = length, radius

    def sample(self, points: Tensor, /) -> tuple[Tensor, Tensor]:
        apart = points.clone()
        apart[..., 0] = points[..., 0] - points[..., 0].clamp(0, self.length)
        distance = apart.norm(dim=-1)
        return distance - self.radius, apart / distance.clamp_min(1e-12)[..., None]


BOX = (torch.tensor((-0.05, -0.05, -0.05), dtype=torch.float64), torch.tensor((0.15, 0.05, 0.05), dtype=torch.float64))


def test_points_lie_on_the_surface_and_cover_it() -> None:
    target = hull_target(Capsule(), *BOX, pitch=0.005, points=400)
    value, normals = target.field.sample(target.points)
    assert len(target.points) == 400
    assert float(value.abs().max()) < 1e-9
    assert torch.allclose(target.normals, normals, atol=1e-9)
    everywhere = hull_target(Capsule(), *BOX, pitch=0.0025, points=4000).points
    assert float(torch.cdist(everywhere, target.points).amin(1).max()) < 0.012


def test_inner_points_are_deep_inside() -> None:
    target = hull_target(Capsule(), *BOX, pitch=0.0031)
    assert torch.allclose(target.depth, -target.field.sample(target.inner)[0])
    assert float(target.depth.max()) == pytest.approx(0.02, abs=0.002)
    volume = len(target.inner) * 0.0031**3
    assert volume == pytest.approx(torch.pi * 0.02**2 * (0.1 + 4 / 3 * 0.02), rel=0.05)


def test_no_hull_is_empty() -> None:
    target = hull_target(Capsule(radius=-1.0), *BOX, pitch=0.01)
    assert target.is_empty
    assert not len(target.inner)


def test_by_the_grid_of_a_field(rig: Any) -> None:
    """The same hull as asked point by point; the surface is within the octants' size of the true skin."""
    pose = posture("open")
    pose[1] = 0.09
    target = rig.target(pose, rig.upright, points=300)
    size = torch.tensor(target.field.values.shape) - 1
    upper = target.field.origin + size * target.field.pitch - 1e-9
    other = hull_target(target.field, target.field.origin, upper, pitch=target.field.pitch, points=300)
    inside = target.field.values < 0
    assert len(target.inner) == len(other.inner) == int(inside.sum())
    assert float(target.depth.max()) == pytest.approx(float(other.depth.max()))
    assert float(torch.cdist(other.points, target.points).amin(1).mean()) < 0.006
    with pytest.raises(ValueError, match=r"points: expected 1 or more, got 0"):
        target_of(target.field, points=0)


def test_wrong_boxes_are_named() -> None:
    low, high = BOX
    with pytest.raises(ValueError, match="box: expected upper above lower"):
        hull_target(Capsule(), high, low)
    with pytest.raises(ValueError, match=r"pitch: expected above 0 and finite, got 0\.0"):
        hull_target(Capsule(), low, high, pitch=0.0)
    with pytest.raises(ValueError, match=r"points: expected 1 or more, got 0"):
        hull_target(Capsule(), low, high, points=0)


def test_vertices_are_spread_evenly_with_their_areas(rig: Any) -> None:
    chosen, share = spread_vertices(rig.hand, 200)
    assert len(chosen) == len(chosen.unique()) == 200
    assert float(share.sum()) == pytest.approx(1)
    assert float(share.min()) > 0
    vertices = rig.hand(torch.zeros(36, dtype=torch.float64)).vertices
    to_all = torch.cdist(vertices, vertices[chosen]).amin(1)
    random = torch.randperm(len(vertices), generator=torch.Generator().manual_seed(1))[:200]
    assert float(to_all.max()) < 0.7 * float(torch.cdist(vertices, vertices[random]).amin(1).max())
    everything, _ = spread_vertices(rig.hand, 10_000)
    assert len(everything) == len(vertices)
