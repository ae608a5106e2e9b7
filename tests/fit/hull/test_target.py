"""Points on a hull's surface and inside it, from the grid of its field."""

from typing import Any

import pytest
import torch
from torch import Tensor

from torchhand.fit.hull.target import target_of
from torchhand.hand import HandPose, posture
from torchhand.volume import HullField

LENGTH, RADIUS = 0.1, 0.02
LOWER, UPPER = (-0.05, -0.05, -0.05), (0.15, 0.05, 0.05)


def distance(points: Tensor, radius: float = RADIUS) -> Tensor:
    """From the surface of a capsule that leads from the origin along x."""
    offset = points.clone()
    offset[..., 0] = points[..., 0] - points[..., 0].clamp(0, LENGTH)
    return offset.norm(dim=-1) - radius


def capsule(pitch: float, radius: float = RADIUS) -> HullField:
    """Its field on a grid."""
    axes = [torch.arange(low, high, pitch, dtype=torch.float64) for low, high in zip(LOWER, UPPER, strict=True)]
    grid = torch.stack(torch.meshgrid(*axes, indexing="ij"), -1)
    return HullField(
        values=distance(grid, radius).float(), origin=torch.tensor(LOWER, dtype=torch.float64), pitch=pitch
    )


def test_points_lie_on_the_surface_and_cover_it() -> None:
    target = target_of(capsule(0.005), points=400)
    assert len(target.points) == 400
    value, normals = target.field.sample(target.points)
    assert float(value.abs().max()) <= 0.25 * 0.005
    assert torch.allclose(target.normals, torch.nn.functional.normalize(normals, dim=-1))
    assert float(distance(target.points).abs().max()) < 0.0015  # the field is linear within 5 mm
    everywhere = target_of(capsule(0.0025), points=4000).points
    assert float(torch.cdist(everywhere, target.points).amin(1).max()) < 0.012


def test_inner_points_are_deep_inside() -> None:
    target = target_of(capsule(0.0031))
    assert torch.allclose(target.depth, -distance(target.inner), atol=1e-7)
    assert float(target.depth.max()) == pytest.approx(0.02, abs=0.002)
    volume = len(target.inner) * 0.0031**3
    assert volume == pytest.approx(torch.pi * 0.02**2 * (0.1 + 4 / 3 * 0.02), rel=0.05)


def test_no_hull_is_empty() -> None:
    target = target_of(capsule(0.01, radius=-1.0))
    assert target.is_empty
    assert not len(target.inner)


def test_of_a_hand(rig: Any) -> None:
    """The surface is within the octants' size of the true skin, but for what no camera sees into."""
    dofs = posture("open", dtype=torch.float64)
    dofs[1] = 0.09
    pose = HandPose.of(dofs, rig.upright)
    target = rig.target(pose, points=300)
    assert len(target.inner) == int((target.field.values < 0).sum())
    skin = rig.vertices(pose)
    assert float(torch.cdist(skin, target.points).amin(1).mean()) < 0.008
    inside, _ = target.field.sample(skin)
    assert float((inside < 0.002).double().mean()) > 0.95


def test_wrong_wishes_are_named() -> None:
    with pytest.raises(ValueError, match=r"points: expected 1 or more, got 0"):
        target_of(capsule(0.01), points=0)
    one = capsule(0.01)
    two = HullField(values=one.values.expand(2, -1, -1, -1), origin=one.origin.expand(2, 3), pitch=one.pitch)
    with pytest.raises(ValueError, match=r"field: expected that of one frame, got a batch \(2,\)"):
        target_of(two)
