"""Outline points: on their conics, continuous, ending on the clips, differentiable, harmless where degenerate."""

import math
from dataclasses import fields, replace
from typing import Any

import pytest
import torch
from torch import Tensor

from torchhand.geometry import conic_of_quadric, evaluate, orthographic_conic_of_quadric
from torchhand.hand import CONE_NAMES, ELLIPSOID_NAMES, Primitives, place_primitives, primitive_sizes
from torchhand.view.outlines.outline import Outline, OutlineTable, outline, outline_points, outline_table, pixel_normals

KINDS = ("pinhole", "orthographic")
CONES = len(CONE_NAMES)


def _image(points: Tensor, kind: str) -> Tensor:
    """Homogeneous points of the normalised plane."""
    if kind == "orthographic":
        return torch.cat((points[..., :2], torch.ones_like(points[..., :1])), -1)
    return points / points[..., 2:]


def _conics(primitives: Primitives, kind: str) -> Tensor:
    quadrics, _ = primitives.quadrics()
    return (orthographic_conic_of_quadric if kind == "orthographic" else conic_of_quadric)(quadrics)


def _tangent(conics: Tensor, points: Tensor) -> Tensor:
    return (conics @ points[..., None]).squeeze(-1)


def _seen(scene: Any, kind: str, generator: torch.Generator, *batch: int) -> tuple[Primitives, OutlineTable, Outline]:
    projector = scene.projector(scene.camera(kind))
    primitives = scene.primitives(projector, *scene.pose(generator, *batch))
    table = outline_table(3, 5)
    return primitives, table, outline(primitives, table, is_orthographic=kind == "orthographic")


@pytest.mark.parametrize("kind", KINDS)
def test_points_lie_on_surface_and_conic(kind: str, scene: Any, generator: torch.Generator) -> None:
    primitives, table, seen = _seen(scene, kind, generator, 20)
    quadrics, clips = (x[:, table.primitive] for x in primitives.quadrics())
    real = seen.is_real
    assert float(real.double().mean()) > 0.5
    on_surface = evaluate(quadrics, seen.points_cam)[real]
    torch.testing.assert_close(on_surface, torch.zeros_like(on_surface), atol=1e-11, rtol=0)
    kept = evaluate(clips, seen.points_cam)[real] / clips.abs().amax((-1, -2))[real]
    assert float(kept.min()) > -1e-12
    image = _image(seen.points_cam, kind)
    tangent = _tangent(_conics(primitives, kind)[:, table.primitive], image)
    off_conic = ((image * tangent).sum(-1).abs() / (image.norm(dim=-1) * tangent.norm(dim=-1)))[real]
    assert float(off_conic.max()) < 1e-9


@pytest.mark.parametrize("kind", KINDS)
def test_normals_are_outward_tangents(kind: str, scene: Any, generator: torch.Generator) -> None:
    """Parallel to the tangent l = C x of the outline, in the picture; and a step along them leaves the surface."""
    primitives, table, seen = _seen(scene, kind, generator, 20)
    real = seen.is_real
    line = _tangent(_conics(primitives, kind)[:, table.primitive], _image(seen.points_cam, kind))
    a, b = (torch.nn.functional.normalize(x[..., :2], dim=-1)[real] for x in (line, seen.normals_cam))
    crossed = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    torch.testing.assert_close(crossed, torch.zeros_like(crossed), atol=1e-7, rtol=0)
    step = 1e-4 * torch.nn.functional.normalize(seen.normals_cam, dim=-1)
    quadrics = primitives.quadrics()[0][:, table.primitive]
    assert bool((evaluate(quadrics, seen.points_cam + step) > evaluate(quadrics, seen.points_cam))[real].all())
    if kind == "pinhole":  # the line of sight grazes the surface
        sight = torch.nn.functional.normalize(seen.points_cam, dim=-1)
        grazing = (sight * torch.nn.functional.normalize(seen.normals_cam, dim=-1)).sum(-1)[real]
        torch.testing.assert_close(grazing, torch.zeros_like(grazing), atol=1e-9, rtol=0)


@pytest.mark.parametrize("kind", KINDS)
def test_points_correspond_under_small_motion(kind: str, scene: Any, generator: torch.Generator) -> None:
    """A step of 1e-6 in every degree of freedom moves a point as its derivative says."""
    projector = scene.projector(scene.camera(kind))
    pose, reference = scene.pose(generator)
    table = outline_table(2, 3)

    def points(pose: Tensor) -> Tensor:
        return outline_points(
            scene.primitives(projector, pose, reference), table, is_orthographic=kind == "orthographic"
        )

    real = outline(scene.primitives(projector, pose, reference), table, is_orthographic=kind == "orthographic").is_real
    step = 1e-6 * torch.randn(36, generator=generator, dtype=torch.float64)
    slope = torch.autograd.functional.jvp(points, pose, step)[1]
    moved = points(pose + step) - points(pose)
    assert float(slope[real].norm(dim=-1).max()) > 1e-8
    torch.testing.assert_close(moved[real], slope[real], atol=2e-9, rtol=0)


@pytest.mark.parametrize("kind", KINDS)
def test_ends_lie_on_the_clipping_planes(kind: str, scene: Any, generator: torch.Generator) -> None:
    projector = scene.projector(scene.camera(kind))
    primitives = scene.primitives(projector, *scene.pose(generator, 10))
    generators = torch.arange(2 * CONES)
    balls = torch.arange(len(ELLIPSOID_NAMES))
    ends = OutlineTable(
        cone=(generators // 2).repeat(2),
        cone_side=(generators % 2).repeat(2),
        cone_fraction=torch.tensor((0.0, 1.0), dtype=torch.float64).repeat_interleave(len(generators)),
        ellipsoid=balls.repeat(2),
        ellipsoid_fraction=torch.tensor((0.0, 1.0), dtype=torch.float64).repeat_interleave(len(balls)),
    )
    seen = outline(primitives, ends, is_orthographic=kind == "orthographic")
    parts = primitives.implicit()
    height = (parts.axis.movedim(-1, 0)[:, ends.primitive] * seen.points_cam).sum(-1)
    low, high = parts.low.T[:, ends.primitive], parts.high.T[:, ends.primitive]
    at_end = torch.minimum((height - low).abs(), (height - high).abs()) < 1e-9
    is_half = torch.tensor([name.endswith("tip") or name.startswith("palm") for name in ELLIPSOID_NAMES])
    whole = torch.cat((torch.zeros(len(ends.cone), dtype=torch.bool), ~is_half.repeat(2)))
    # A half ellipsoid whose whole outline is kept has no ends: its arc closes.
    first, second = seen.points_cam[:, len(ends.cone) :].unflatten(1, (2, len(balls))).unbind(1)
    closes = torch.cat(
        (torch.zeros(10, len(ends.cone), dtype=torch.bool), ((first - second).norm(dim=-1) < 1e-9).repeat(1, 2)), 1
    )
    assert bool((at_end | whole | closes | ~seen.is_real).all())
    assert bool((closes | ~whole).all())
    assert int((at_end & seen.is_real).sum()) > 300


def test_a_sphere_shows_a_circle(scene: Any) -> None:
    """A joint's sphere at distance d: circle of radius r / √(d² - r²) about its centre's image."""
    projector = scene.projector(scene.camera())
    pose = torch.zeros(36, dtype=torch.float64)
    pose[2] = 0.5
    primitives = scene.primitives(projector, pose, torch.eye(3, dtype=torch.float64))
    i = ELLIPSOID_NAMES.index("middle_pip")
    table = outline_table(1, 12).select(
        torch.cat((torch.zeros(2 * CONES), torch.arange(22).repeat_interleave(12) == i)).bool()
    )
    points = outline(primitives, table).points_cam
    centre, radius = primitives.ellipsoid_position[i], primitives.sizes.ellipsoid_axes[i, 0]
    distance = centre.norm()
    cosine = (points @ centre) / (points.norm(dim=-1) * distance)
    expected = (1 - (radius / distance) ** 2).sqrt().expand_as(cosine)
    torch.testing.assert_close(cosine, expected, atol=1e-14, rtol=0)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
@pytest.mark.parametrize("side", ["right", "left"])
def test_batches_equal_a_loop(
    kind: str, batch: tuple[int, ...], side: str, scene: Any, generator: torch.Generator
) -> None:
    projector = scene.projector(scene.camera(kind), side)
    pose, reference = scene.pose(generator, *batch)
    table = outline_table(2, 3)
    orthographic = kind == "orthographic"
    together = outline(scene.primitives(projector, pose, reference), table, is_orthographic=orthographic)
    alone = [
        outline(scene.primitives(projector, row, reference), table, is_orthographic=orthographic)
        for row in pose.reshape(-1, 36)
    ]
    for name in ("points_cam", "normals_cam", "is_real"):
        value = getattr(together, name)
        expected = torch.stack([getattr(one, name) for one in alone]).reshape(value.shape)
        torch.testing.assert_close(value, expected, atol=1e-10, rtol=1e-10)
    pixels = projector.outline_px(pose, reference, table)
    torch.testing.assert_close(pixels, projector.camera.project(together.points_cam), atol=1e-9, rtol=0)


@pytest.mark.parametrize("kind", KINDS)
def test_derivatives(kind: str, scene: Any, generator: torch.Generator) -> None:
    projector = scene.projector(scene.camera(kind, lens=0))
    pose, reference = scene.pose(generator)
    every = outline_table(1, 1)
    real = outline(scene.primitives(projector, pose, reference), every, is_orthographic=kind == "orthographic").is_real
    table = every.select(real)
    leaf = pose.requires_grad_()
    assert torch.autograd.gradcheck(
        lambda pose: projector.outline_px(pose, reference, table), (leaf,), atol=1e-4, rtol=1e-5
    )


def test_derivatives_with_the_shape(scene: Any, generator: torch.Generator) -> None:
    projector = scene.projector(scene.camera())
    pose, reference = scene.pose(generator)
    every = outline_table(1, 1)
    table = every.select(outline(scene.primitives(projector, pose, reference), every).is_real)
    kinematics = projector.kinematics
    shape = kinematics.default_shape.clone().requires_grad_()

    def points(shape: Tensor) -> Tensor:
        frames = kinematics(pose, shape, root_reference=reference)
        return outline_points(place_primitives(frames, primitive_sizes(kinematics.shape_space, shape)), table)

    assert torch.autograd.gradcheck(points, (shape,), eps=1e-7, atol=1e-6, rtol=1e-4)


def _facing(primitives: Primitives, name: str, turn: Tensor, position: tuple[float, float, float]) -> Primitives:
    """The hand moved so that one primitive has the given orientation and place."""
    i = CONE_NAMES.index(name) if name in CONE_NAMES else CONES + ELLIPSOID_NAMES.index(name)
    rotation = turn @ primitives.rotation[i].T
    return primitives.moved(rotation, torch.tensor(position, dtype=torch.float64) - rotation @ primitives.position[i])


AWAY = torch.tensor(((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)), dtype=torch.float64)  # y axis along the view


@pytest.mark.parametrize(
    ("name", "position", "kind"),
    [
        ("index_middle", (0.0, 0.0, 0.4), "pinhole"),  # seen along its axis
        ("index_middle", (0.0, 0.0, 0.4), "orthographic"),
        ("palm", (0.0, 0.0, -0.02), "pinhole"),  # the camera is inside
        ("palm_fingers", (0.0, 0.0, 0.0), "pinhole"),
        ("thumb_thenar", (0.0, 0.0, 0.001), "pinhole"),
        ("little_tip", (0.0, 0.0, 0.4), "pinhole"),  # a half sphere whose kept half looks away
    ],
)
def test_degenerate_views_are_marked_and_finite(
    name: str, position: tuple[float, float, float], kind: str, scene: Any
) -> None:
    projector = scene.projector(scene.camera())
    base = scene.primitives(projector, torch.zeros(36, dtype=torch.float64), torch.eye(3, dtype=torch.float64))
    primitives = _facing(base, name, AWAY, position)
    rotation, place = primitives.rotation.clone().requires_grad_(), primitives.position.clone().requires_grad_()
    leaf = replace(primitives, rotation=rotation, position=place)
    table = outline_table(2, 4)
    seen = outline(leaf, table, is_orthographic=kind == "orthographic")
    i = CONE_NAMES.index(name) if name in CONE_NAMES else CONES + ELLIPSOID_NAMES.index(name)
    assert not bool(seen.is_real[table.primitive == i].any())
    assert bool(seen.points_cam.isfinite().all())
    assert bool(seen.normals_cam.isfinite().all())
    seen.points_cam.sum().backward()
    assert rotation.grad is not None
    assert place.grad is not None
    assert bool(rotation.grad.isfinite().all())
    assert bool(place.grad.isfinite().all())


def test_float32_has_finite_gradients(scene: Any, generator: torch.Generator) -> None:
    """The clamp that keeps the angle's derivative finite must not round to 1 in single precision."""
    projector = scene.projector(scene.camera())
    primitives = scene.primitives(projector, *scene.pose(generator, 40))
    sizes = replace(
        primitives.sizes, **{n: getattr(primitives.sizes, n).float() for n in primitives.sizes.__dataclass_fields__}
    )
    rotation, position = (x.float().requires_grad_() for x in (primitives.rotation, primitives.position))
    single = Primitives(sizes=sizes, rotation=rotation, position=position)
    points = outline_points(single, outline_table(2, 4, dtype=torch.float32))
    points.sum().backward()
    assert rotation.grad is not None
    assert bool(rotation.grad.isfinite().all())
    real = outline(primitives, outline_table(2, 4)).is_real
    close = (points.detach().double() - outline_points(primitives, outline_table(2, 4)))[real].norm(dim=-1)
    assert float(close.quantile(0.99)) < 2e-5


@pytest.mark.parametrize("lens", [0, 5, 8])
def test_pixel_normals_through_the_lens(lens: int, scene: Any, generator: torch.Generator) -> None:
    """Perpendicular, in pixels, to the image of a short stretch of the tangent line, and pointing the same way out."""
    camera = scene.camera(lens=lens, width=640, height=480)
    _, _, seen = _seen(scene, "pinhole", generator, 3)
    plane = camera.plane_from_cam(seen.points_cam)
    normals = pixel_normals(camera, plane, seen.normals_cam)
    flat = torch.nn.functional.normalize(seen.normals_cam[..., :2], dim=-1)
    along = torch.stack((-flat[..., 1], flat[..., 0]), -1)
    stretch = camera.pixels_from_plane(plane + 1e-6 * along) - camera.pixels_from_plane(plane - 1e-6 * along)
    outwards = camera.pixels_from_plane(plane + 1e-6 * flat) - camera.pixels_from_plane(plane)
    real = seen.is_real
    slope = ((normals * stretch).sum(-1) / stretch.norm(dim=-1))[real]
    torch.testing.assert_close(slope, torch.zeros_like(slope), atol=1e-6, rtol=0)
    assert bool(((normals * outwards).sum(-1) > 0)[real].all())
    torch.testing.assert_close(normals.norm(dim=-1)[real], torch.ones_like(slope))


def test_tables() -> None:
    table = outline_table(3, 5, without=("palm_wrist", "palm"))
    assert table.size == 2 * 3 * 14 + 5 * 21
    assert len(table.primitive) == table.size
    assert CONE_NAMES.index("palm") not in table.primitive
    assert CONES + ELLIPSOID_NAMES.index("palm_wrist") not in table.primitive
    assert math.isclose(float(table.cone_fraction[0]), 1 / 6)
    keep = torch.arange(table.size) % 3 == 0
    chosen = table.select(keep)
    assert torch.equal(chosen.primitive, table.primitive[keep])
    assert chosen.size == int(keep.sum())


@pytest.mark.parametrize("factor", [1, 2, 3, 100])
def test_a_thinned_table_has_the_same_curves_with_fewer_points(factor: int) -> None:
    thinned = outline_table(12, 8, without=("palm_wrist",)).thinned(factor)
    expected = outline_table(max(2, 12 // factor), max(2, 8 // factor), without=("palm_wrist",))
    for field in fields(OutlineTable):
        torch.testing.assert_close(getattr(thinned, field.name), getattr(expected, field.name))
