"""Quadrics, conics, clips and rays against closed forms and numpy's polynomial roots."""

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from torchhand.geometry.quadrics import (
    cone,
    conic_of_quadric,
    ellipsoid,
    evaluate,
    half_space,
    meet_rays,
    moved,
    orthographic_conic_of_quadric,
    quadratic_roots,
    ray_table,
    slab,
)
from torchhand.geometry.rotations import rotation_from_vector


def _number(*values: float) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def _random(generator: torch.Generator, *shape: int) -> Tensor:
    return torch.randn(*shape, generator=generator, dtype=torch.float64)


def _placed_parts(generator: torch.Generator, count: int = 40) -> tuple[Tensor, Tensor]:
    """Ellipsoids, cones and cylinders anywhere in front of the camera, with their clips."""
    size = 0.5 + torch.rand(count, 3, generator=generator, dtype=torch.float64)
    scale = 0.4 + torch.rand(count, generator=generator, dtype=torch.float64)
    scale[: count // 4] = 1.0
    balls, cones = ellipsoid(size), cone(size[:, ::2], scale, size[:, 1])
    levels = torch.rand(count, generator=generator, dtype=torch.float64) - 0.5
    clips = torch.cat((half_space(levels * size[:, 1]), slab(0 * scale, size[:, 1])))
    rotation = rotation_from_vector(_random(generator, 2 * count, 3))
    translation = _random(generator, 2 * count, 3) + _number(0.0, 0.0, 6.0)
    return moved(torch.cat((balls, cones)), rotation, translation), moved(clips, rotation, translation)


def test_surfaces() -> None:
    """Points on each surface by its definition."""
    angle = torch.linspace(0, 6, 9, dtype=torch.float64)
    circle = torch.stack((angle.cos(), torch.zeros_like(angle), angle.sin()), -1)
    ball = ellipsoid(_number(0.3, 0.5, 0.7))
    on_ball = _number(0.3, 0.5, 0.7) * (0.8 * circle + _number(0.0, 0.6, 0.0))
    torch.testing.assert_close(
        evaluate(ball.expand(9, 4, 4), on_ball), torch.zeros(9, dtype=torch.float64), atol=1e-14, rtol=0
    )
    for scale in (0.5, 1.0, 1.3):
        shape = cone(
            _number(0.3, 0.2), torch.tensor(scale, dtype=torch.float64), torch.tensor(2.0, dtype=torch.float64)
        )
        for y in (0.0, 0.7, 2.0):
            radius = 1 + (scale - 1) * y / 2.0
            on_cone = radius * _number(0.3, 0.0, 0.2) * circle + _number(0.0, y, 0.0)
            value = evaluate(shape.expand(9, 4, 4), on_cone)
            torch.testing.assert_close(value, torch.zeros(9, dtype=torch.float64), atol=1e-14, rtol=0)
            assert bool((evaluate(shape.expand(9, 4, 4), 0.9 * on_cone + 0.1 * _number(0.0, y, 0.0)) < 0).all())


def test_a_cone_passes_smoothly_into_a_cylinder() -> None:
    start, length = _number(0.3, 0.2), torch.tensor(2.0, dtype=torch.float64)
    near, exact = (cone(start, torch.tensor(s, dtype=torch.float64), length) for s in (1 + 1e-9, 1.0))
    torch.testing.assert_close(near, exact, atol=1e-9, rtol=0)


def test_clip_signs() -> None:
    heights = _number(-0.1, 0.1, 1.9, 2.1)
    points = torch.stack((0 * heights + 5, heights, 0 * heights - 3), -1)
    kept = evaluate(slab(_number(0.0)[0], _number(2.0)[0]).expand(4, 4, 4), points) >= 0
    assert kept.tolist() == [False, True, True, False]
    kept = evaluate(half_space(_number(0.0)[0]).expand(4, 4, 4), points) >= 0
    assert kept.tolist() == [False, True, True, True]
    exact = evaluate(slab(_number(0.0)[0], _number(2.0)[0]).expand(4, 4, 4), points)
    torch.testing.assert_close(exact, 2 * heights * (2 - heights))


def test_moved_follows_its_points(generator: torch.Generator) -> None:
    quadric = _random(generator, 5, 4, 4)
    quadric = quadric + quadric.mT
    rotation, translation = rotation_from_vector(_random(generator, 5, 3)), _random(generator, 5, 3)
    points = _random(generator, 5, 3)
    there = (rotation @ points[..., None]).squeeze(-1) + translation
    torch.testing.assert_close(evaluate(moved(quadric, rotation, translation), there), evaluate(quadric, points))
    inverse = torch.eye(4, dtype=torch.float64).repeat(5, 1, 1)
    inverse[:, :3, :3], inverse[:, :3, 3:] = rotation.mT, -rotation.mT @ translation[..., None]
    torch.testing.assert_close(moved(quadric, rotation, translation), inverse.mT @ quadric @ inverse)


def test_a_sphere_appears_as_a_circle() -> None:
    """The conic is C = diag(d² - r², d² - r², -r²), a circle of radius r / √(d² - r²)."""
    d, r = 3.0, 0.7
    sphere = moved(ellipsoid(_number(r, r, r)), torch.eye(3, dtype=torch.float64), _number(0.0, 0.0, d)) * r * r
    expected = torch.diag(_number(d * d - r * r, d * d - r * r, -r * r))
    torch.testing.assert_close(conic_of_quadric(sphere), expected, atol=1e-14, rtol=0)
    flat = orthographic_conic_of_quadric(sphere)
    torch.testing.assert_close(flat, torch.diag(_number(1.0, 1.0, -r * r)), atol=1e-14, rtol=0)


def ray_coefficients(quadric: Tensor, origin: Tensor, direction: Tensor) -> Tensor:
    """The specification of `ray_table`: a, b, c of a s² + 2 b s + c, one quadric for each ray."""
    upper, edge = quadric[..., :3, :3], quadric[..., :3, 3]
    along = (upper @ direction[..., None]).squeeze(-1)
    quadratic = (direction * along).sum(-1)
    linear = (origin * along).sum(-1) + (edge * direction).sum(-1)
    return torch.stack(torch.broadcast_tensors(quadratic, linear, evaluate(quadric, origin)))


def _meets(quadric: Tensor, origin: Tensor, direction: Tensor) -> bool:
    a, b, c = ray_coefficients(quadric, origin, direction)
    return bool(np.isreal(np.roots([float(a), 2 * float(b), float(c)])).all())


def test_a_ray_meets_the_quadric_where_the_conic_is_not_positive(generator: torch.Generator) -> None:
    """Rays meet the quadric where xᵀ C x <= 0: over ellipsoids, cones and cylinders, for both kinds of camera."""
    quadrics, _ = _placed_parts(generator, 20)
    seen = []
    for quadric in quadrics:
        plane = 0.4 * _random(generator, 3)
        plane[2] = 1
        central = plane @ conic_of_quadric(quadric) @ plane
        assert (float(central) <= 0) == _meets(quadric, torch.zeros(3, dtype=torch.float64), plane)
        spot = torch.cat((1.5 * _random(generator, 2), _number(1.0)))
        parallel = spot @ orthographic_conic_of_quadric(quadric) @ spot
        origin = torch.cat((spot[:2], _number(0.0)))
        assert (float(parallel) <= 0) == _meets(quadric, origin, _number(0.0, 0.0, 1.0))
        seen += [float(central) <= 0, float(parallel) <= 0]
    assert 5 < sum(seen) < len(seen) - 5, "both cases must occur"


def test_meeting_points_are_numpys_roots(generator: torch.Generator) -> None:
    quadrics, clips = _placed_parts(generator, 40)
    count = len(quadrics)
    origin, direction = _random(generator, count, 3), _random(generator, count, 3)
    direction = 0.3 * direction + _number(0.0, 0.0, 6.0) - origin
    hits = meet_rays(ray_coefficients(quadrics, origin, direction), ray_coefficients(clips, origin, direction))
    hit_count = 0
    for i in range(count):
        a, b, c = (float(x) for x in ray_coefficients(quadrics[i], origin[i], direction[i]))
        roots = [x.real for x in np.roots([a, 2 * b, c]) if abs(x.imag) < 1e-12 and x.real > 0]
        points = [origin[i] + root * direction[i] for root in roots]
        kept = sorted(root for root, point in zip(roots, points, strict=True) if float(evaluate(clips[i], point)) >= 0)
        assert bool(hits.is_hit[i]) == bool(kept)
        if kept:
            hit_count += 1
            assert float(hits.near[i]) == pytest.approx(kept[0], rel=1e-9)
            assert float(hits.far[i]) == pytest.approx(kept[-1], rel=1e-9)
        else:
            assert math.isinf(float(hits.near[i]))
    assert 10 < hit_count < count - 10


def test_ray_table_is_every_ray_with_every_quadric(generator: torch.Generator) -> None:
    quadrics, _ = _placed_parts(generator, 3)
    origins, directions = _random(generator, 4, 3), _random(generator, 4, 3)
    table = ray_table(quadrics, origins, directions)
    for ray in range(4):
        for part in range(len(quadrics)):
            single = ray_coefficients(quadrics[part], origins[ray], directions[ray])
            torch.testing.assert_close(table[:, ray, part], single, atol=1e-12, rtol=1e-12)


def test_a_vanishing_leading_coefficient_leaves_the_linear_root() -> None:
    linear, constant = _number(1.5, -1.5, 1.5), _number(-3.0, 3.0, 3.0)
    for quadratic in (0.0, 1e-18, -1e-18):
        _, second = quadratic_roots(torch.full_like(linear, quadratic), linear, constant)
        torch.testing.assert_close(second, -constant / (2 * linear), rtol=1e-12, atol=0)
    first, _ = quadratic_roots(torch.zeros_like(linear), linear, constant)
    assert bool(first.isinf().all())
    no_roots = quadratic_roots(_number(1.0), _number(0.0), _number(1.0))
    assert all(bool(root.isinf().all()) for root in no_roots)


def test_roots_do_not_cancel() -> None:
    """x² - 2e8 x + 1: the small root would be lost to cancellation in the school formula."""
    roots = sorted(float(root) for root in quadratic_roots(_number(1.0), _number(-1e8), _number(1.0)))
    assert roots == pytest.approx([5e-9, 2e8], rel=1e-14)


def test_derivatives(generator: torch.Generator) -> None:
    vector, translation = _random(generator, 3).requires_grad_(), _random(generator, 3).requires_grad_()
    size = _number(0.3, 0.5, 0.4).requires_grad_()
    scale = torch.tensor(0.8, dtype=torch.float64, requires_grad=True)

    def conics(size: Tensor, scale: Tensor, vector: Tensor, translation: Tensor) -> tuple[Tensor, ...]:
        rotation = rotation_from_vector(vector)
        ball, part = (
            moved(ellipsoid(size), rotation, translation),
            moved(cone(size[:2], scale, size[2]), rotation, translation),
        )
        return (
            conic_of_quadric(ball),
            orthographic_conic_of_quadric(part),
            moved(slab(scale, size[0]), rotation, translation),
        )

    assert torch.autograd.gradcheck(conics, (size, scale, vector, translation))


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_batches_equal_a_loop(batch: tuple[int, ...], generator: torch.Generator) -> None:
    size = 0.5 + torch.rand(*batch, 3, generator=generator, dtype=torch.float64)
    vector, translation = _random(generator, *batch, 3), _random(generator, *batch, 3)

    def conic(size: Tensor, vector: Tensor, translation: Tensor) -> Tensor:
        return conic_of_quadric(
            moved(cone(size[..., :2], size[..., 2], size[..., 0]), rotation_from_vector(vector), translation)
        )

    rows = zip(*(x.reshape(-1, 3) for x in (size, vector, translation)), strict=True)
    expected = torch.stack([conic(*row) for row in rows]).reshape(*batch, 3, 3)
    torch.testing.assert_close(conic(size, vector, translation), expected, atol=1e-12, rtol=1e-12)
