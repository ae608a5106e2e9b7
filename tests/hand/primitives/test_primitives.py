"""The 37 quadrics: their number, their places and sizes, and that every form of them is the same surface."""

import math

import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.geometry import batch_first, evaluate, rotation_from_vector
from torchhand.hand.kinematics import BONES, FINGERS, posture
from torchhand.hand.primitives.primitives import (
    CONE_NAMES,
    ELLIPSOID_NAMES,
    PRIMITIVE_NAMES,
    Primitives,
    place_primitives,
)
from torchhand.hand.primitives.sizing import primitive_sizes

MODEL = load_hand_model()
MIRROR = torch.tensor((1.0, 1.0, -1.0), dtype=torch.float64)


def _placed(generator: torch.Generator, *batch: int, side: str = "right", has_shapes: bool = False) -> Primitives:
    kinematics = MODEL.kinematics("left" if side == "left" else "right", dtype=torch.float64)
    pose = 0.3 * torch.randn(*batch, 36, generator=generator, dtype=torch.float64)
    shape = kinematics.default_shape
    if has_shapes:
        shape = shape * (1 + 0.05 * torch.randn(*batch, len(shape), generator=generator, dtype=torch.float64))
    sizes = primitive_sizes(MODEL.shape_space, shape)
    return place_primitives(kinematics(pose, shape), sizes, is_left=side == "left")


def _surface(primitives: Primitives) -> tuple[Tensor, Tensor]:
    """Points on the kept surface of every primitive, and the primitive of each, from their definitions."""
    sizes, points, parts = primitives.sizes, [], []
    angle = torch.linspace(0, 2 * math.pi, 7, dtype=torch.float64)[:-1]
    circle = torch.stack((angle.cos(), torch.zeros_like(angle), angle.sin()), -1)
    up = torch.tensor((0.0, 1.0, 0.0), dtype=torch.float64)
    for i in range(len(CONE_NAMES)):
        section = torch.stack((sizes.cone_start[i, 0], torch.zeros_like(angle[0]), sizes.cone_start[i, 1]))
        for t in (0.02, 0.5, 0.98):
            local = (1 + (sizes.cone_end_scale[i] - 1) * t) * section * circle + t * sizes.cone_length[i] * up
            points.append(local @ primitives.cone_rotation[i].T + primitives.cone_position[i])
            parts += [i] * len(angle)
    for i in range(len(ELLIPSOID_NAMES)):
        for t in (0.05, 0.6):
            local = sizes.ellipsoid_axes[i] * (math.sqrt(1 - t * t) * circle + t * up)
            points.append(local @ primitives.ellipsoid_rotation[i].T + primitives.ellipsoid_position[i])
            parts += [len(CONE_NAMES) + i] * len(angle)
    return torch.cat(points), torch.tensor(parts)


def test_thirty_seven_parts() -> None:
    """Counts that add up to 37: palm 3, each finger 7, thumb 6."""
    assert len(PRIMITIVE_NAMES) == len(set(PRIMITIVE_NAMES)) == 37
    assert len(CONE_NAMES) == 15
    assert len(ELLIPSOID_NAMES) == 22
    counts = {start: sum(name.startswith(start) for name in PRIMITIVE_NAMES) for start in ("palm", *FINGERS)}
    assert counts == {"palm": 3, "thumb": 6, "index": 7, "middle": 7, "ring": 7, "little": 7}
    for finger in FINGERS[1:]:
        assert sum(name.startswith(finger) for name in CONE_NAMES) == 3


@pytest.mark.parametrize("corner", ["lower", "default", "upper"])
def test_sizes_are_positive_within_the_bounds(corner: str) -> None:
    sizes = primitive_sizes(MODEL.shape_space, getattr(MODEL.shape_space, corner))
    for name in ("cone_start", "cone_end_scale", "cone_length", "ellipsoid_axes"):
        assert float(getattr(sizes, name).min()) > 0, name


def test_sizes_are_positive_for_people(generator: torch.Generator) -> None:
    space = MODEL.shape_space
    population = space.default + 3 * space.std * torch.randn(
        500, len(space.names), generator=generator, dtype=torch.float64
    )
    sizes = primitive_sizes(space, population.clamp(space.lower, space.upper))
    assert float(sizes.cone_length.min()) >= 1e-3
    assert float(sizes.ellipsoid_axes.min()) > 2e-3


def test_sizes_follow_the_shape() -> None:
    space = MODEL.shape_space
    metric = space.metric(space.default)
    sizes = primitive_sizes(space, space.default)
    for finger in FINGERS[1:]:
        i = CONE_NAMES.index(f"{finger}_middle")
        assert float(sizes.cone_start[i, 0]) == pytest.approx(float(metric[f"{finger}_pip_radius"]))
        end = sizes.cone_start[i, 0] * sizes.cone_end_scale[i]
        assert float(end) == pytest.approx(float(metric[f"{finger}_dip_radius"]))
        assert float(sizes.cone_length[i]) == pytest.approx(float(metric[f"{finger}_middle"]))
        tip = ELLIPSOID_NAMES.index(f"{finger}_tip")
        skin = sizes.ellipsoid_centre[tip, 1] + sizes.ellipsoid_axes[tip, 1]
        assert float(skin) == pytest.approx(float(metric[f"{finger}_distal"]))
    palm = CONE_NAMES.index("palm")
    breadth = 2 * sizes.cone_start[palm, 1] * sizes.cone_end_scale[palm]
    assert float(breadth) == pytest.approx(float(metric["palm_breadth"]))
    assert float(2 * sizes.cone_start[palm, 1]) == pytest.approx(float(metric["wrist_breadth"]))


def test_a_finger_is_closed_at_its_joints() -> None:
    """The ball at each joint and tip is as thick as the cones that end there."""
    sizes = primitive_sizes(MODEL.shape_space, MODEL.shape_space.default)
    for finger in FINGERS[1:]:
        for bone, joint in (("proximal", "pip"), ("middle", "dip"), ("distal", "tip")):
            cone, ball = CONE_NAMES.index(f"{finger}_{bone}"), ELLIPSOID_NAMES.index(f"{finger}_{joint}")
            end = sizes.cone_start[cone] * sizes.cone_end_scale[cone]
            torch.testing.assert_close(sizes.ellipsoid_axes[ball, ::2], end)
        # At the knuckle's joint centre its ellipsoid is as thick as the finger, to a few percent.
        knuckle = ELLIPSOID_NAMES.index(f"{finger}_mcp")
        centre, axes = sizes.ellipsoid_centre[knuckle], sizes.ellipsoid_axes[knuckle]
        thickness = axes[0] * (1 - (centre[1] / axes[1]) ** 2).sqrt()
        start = sizes.cone_start[CONE_NAMES.index(f"{finger}_proximal"), 0]
        assert float(thickness / start) == pytest.approx(1.0, abs=0.08)


@pytest.mark.parametrize("side", ["right", "left"])
def test_surface_points_lie_on_the_quadrics(side: str, generator: torch.Generator) -> None:
    primitives = _placed(generator, side=side)
    points, parts = _surface(primitives)
    quadrics, clips = primitives.quadrics()
    value = evaluate(quadrics[parts], points)
    torch.testing.assert_close(value, torch.zeros_like(value), atol=1e-11, rtol=0)
    assert bool((evaluate(clips[parts], points) > 0).all())
    centre = torch.cat((primitives.cone_position, primitives.ellipsoid_position))
    axis = torch.cat((primitives.cone_rotation, primitives.ellipsoid_rotation))[..., 1]
    assert bool((evaluate(quadrics, centre + 1e-3 * axis) < 0).all())


@pytest.mark.parametrize("batch", [(), (2, 3)])
@pytest.mark.parametrize("has_shapes", [False, True])
def test_the_parts_are_the_matrices(batch: tuple[int, ...], has_shapes: bool, generator: torch.Generator) -> None:
    """`implicit` against `quadrics`, which is made of the textbook matrices."""
    primitives = _placed(generator, *batch, has_shapes=has_shapes)
    quadrics, clips = primitives.quadrics()
    parts = primitives.implicit()
    scale = quadrics.abs().amax((-1, -2))

    def close(mine: Tensor, expected: Tensor, own: int) -> None:
        relative = scale.reshape(*scale.shape, *(1,) * own)
        torch.testing.assert_close(batch_first(mine, batch) / relative, expected / relative, atol=1e-12, rtol=0)

    close(parts.upper, quadrics[..., :3, :3], 2)
    close(parts.edge, quadrics[..., :3, 3], 1)
    close(parts.corner, quadrics[..., 3, 3], 0)
    points = 0.2 * torch.randn(*batch, 37, 3, generator=generator, dtype=torch.float64)
    height = (batch_first(parts.axis, batch) * points).sum(-1)
    keeps = (height >= batch_first(parts.low, batch)) & (height <= batch_first(parts.high, batch))
    assert torch.equal(keeps, evaluate(clips, points) >= 0)


def test_a_left_hands_surface_is_the_mirror_image(generator: torch.Generator) -> None:
    pose = posture("victory", dtype=torch.float64)
    placed = {}
    for side in ("right", "left"):
        kinematics = MODEL.kinematics("left" if side == "left" else "right", dtype=torch.float64)
        sizes = primitive_sizes(MODEL.shape_space, MODEL.shape_space.default)
        placed[side] = place_primitives(kinematics(pose), sizes, is_left=side == "left")
    points, parts = _surface(placed["right"])
    quadrics, clips = placed["left"].quadrics()
    mirrored = points * MIRROR
    value = evaluate(quadrics[parts], mirrored)
    torch.testing.assert_close(value, torch.zeros_like(value), atol=1e-11, rtol=0)
    assert bool((evaluate(clips[parts], mirrored) > 0).all())
    determinant = torch.linalg.det(placed["left"].rotation)
    torch.testing.assert_close(determinant, torch.ones_like(determinant))


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
@pytest.mark.parametrize("side", ["right", "left"])
def test_batches_equal_a_loop(batch: tuple[int, ...], side: str, generator: torch.Generator) -> None:
    kinematics = MODEL.kinematics("left" if side == "left" else "right", dtype=torch.float64)
    pose = 0.3 * torch.randn(*batch, 36, generator=generator, dtype=torch.float64)
    noise = torch.randn(*batch, len(kinematics.default_shape), generator=generator, dtype=torch.float64)
    shape = kinematics.default_shape * (1 + 0.05 * noise)
    rotation = rotation_from_vector(torch.tensor((0.3, 0.2, -0.5), dtype=torch.float64))
    translation = torch.tensor((0.1, 0.2, 0.7), dtype=torch.float64)

    def quadrics(pose: Tensor, shape: Tensor) -> Tensor:
        sizes = primitive_sizes(MODEL.shape_space, shape)
        placed = place_primitives(kinematics(pose, shape), sizes, is_left=side == "left")
        return torch.stack(placed.moved(rotation, translation).quadrics())

    together = quadrics(pose, shape)
    rows = zip(pose.reshape(-1, 36), shape.reshape(-1, shape.shape[-1]), strict=True)
    alone = torch.stack([quadrics(*row) for row in rows], 1).reshape(together.shape)
    torch.testing.assert_close(together, alone, atol=1e-9, rtol=1e-9)
    if batch:
        sizes = primitive_sizes(MODEL.shape_space, shape.reshape(-1, shape.shape[-1]))
        flat = place_primitives(kinematics(pose.reshape(-1, 36), shape.reshape(-1, shape.shape[-1])), sizes)
        one = flat.select(0).quadrics()[0]
        torch.testing.assert_close(one, flat.quadrics()[0][0], atol=0, rtol=0)


def test_moved_moves_the_surface(generator: torch.Generator) -> None:
    primitives = _placed(generator)
    rotation = rotation_from_vector(torch.randn(3, generator=generator, dtype=torch.float64))
    translation = torch.randn(3, generator=generator, dtype=torch.float64)
    points, parts = _surface(primitives)
    value = evaluate(primitives.moved(rotation, translation).quadrics()[0][parts], points @ rotation.T + translation)
    torch.testing.assert_close(value, torch.zeros_like(value), atol=1e-9, rtol=0)


def test_derivatives(generator: torch.Generator) -> None:
    kinematics = MODEL.kinematics(dtype=torch.float64)
    pose = (0.3 * torch.randn(36, generator=generator, dtype=torch.float64)).requires_grad_()
    shape = kinematics.default_shape.clone().requires_grad_()

    def placed(pose: Tensor, shape: Tensor) -> tuple[Tensor, ...]:
        sizes = primitive_sizes(MODEL.shape_space, shape)
        hand = place_primitives(kinematics(pose, shape), sizes)
        return hand.rotation[::9], hand.position[::3], sizes.cone_start, sizes.cone_end_scale, sizes.ellipsoid_axes

    assert torch.autograd.gradcheck(placed, (pose, shape))


def test_parts_sit_on_their_bones() -> None:
    kinematics = MODEL.kinematics(dtype=torch.float64)
    frames = kinematics(posture("fist", dtype=torch.float64))
    placed = place_primitives(frames, primitive_sizes(MODEL.shape_space, MODEL.shape_space.default))
    for finger in FINGERS[1:]:
        for bone in ("proximal", "middle", "distal"):
            i, b = CONE_NAMES.index(f"{finger}_{bone}"), BONES.index(f"{finger}_{bone}")
            torch.testing.assert_close(placed.cone_position[i], frames.position[b], atol=1e-15, rtol=0)
            torch.testing.assert_close(placed.cone_rotation[i], frames.rotation[b], atol=1e-15, rtol=0)
