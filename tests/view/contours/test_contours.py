"""Contours for registration: their motion against finite differences, which points are outer and which inner."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.geometry import rotation_from_vector
from torchhand.hand import DOFS, PoseSpace, named_pose_space, posture
from torchhand.view.contours.contours import ContourLook, Contours, PrimitiveContours
from torchhand.view.contours.jacobian import OutlineTracer
from torchhand.view.contours.mesh_contours import MeshContours
from torchhand.view.contours.springs import Springs
from torchhand.view.outlines import outline_table
from torchhand.view.raster import mesh_silhouette

STEP = 1e-6
TABLE = outline_table(4, 5, without=("palm_wrist",))


def numerical(contours: Contours, space: PoseSpace, free: Tensor, reference: Tensor, look: ContourLook) -> Tensor:
    """d points / d free by central differences: hands, points, 2, free."""
    columns = []
    for i in range(space.size):
        step = torch.zeros(space.size, dtype=free.dtype)
        step[i] = STEP
        ends = [contours.motion(space.dof(free + sign * step), reference, look).points_px for sign in (1, -1)]
        columns.append((ends[0] - ends[1]) / (2 * STEP))
    return torch.stack(columns, -1)


def hands(scene: Any, generator: torch.Generator, space: PoseSpace, count: int = 2) -> tuple[Tensor, Tensor]:
    pose, reference = scene.pose(generator, count)
    references = rotation_from_vector(0.2 * torch.randn(count, 3, generator=generator).double()) @ reference
    return space.free(pose), references


@pytest.mark.parametrize("kind", ["pinhole", "orthographic", "lens", "moved"])
@pytest.mark.parametrize("name", ["dof26", "dof36", "planar_abduction"])
def test_outlines_move_across_themselves_as_the_closed_form_says(
    kind: str, name: str, scene: Any, generator: torch.Generator
) -> None:
    """Exact across the outline, on cones and ellipsoids; turned roots with rotation vectors included."""
    camera = scene.camera("orthographic" if kind == "orthographic" else "pinhole", lens=5 if kind == "lens" else 0)
    if kind == "moved":
        turn = rotation_from_vector(torch.tensor((0.1, -0.2, 0.3), dtype=torch.float64))
        camera = replace(camera, rotation=turn, translation=torch.tensor((0.02, -0.01, 0.1), dtype=torch.float64))
    space = named_pose_space(name)
    projector = scene.projector(camera, "left" if kind == "moved" else "right")
    contours = PrimitiveContours(projector, TABLE, space.basis)
    free, reference = hands(scene, generator, space)
    look = contours.look(space.dof(free), reference, beyond_px=3.0)
    expected = (numerical(contours, space, free, reference, look) * look.normals[..., None]).sum(-2)
    found = contours.motion(space.dof(free), reference, look).along(look.normals)
    # A point whose generator vanishes jumps: leave out what does not move smoothly.
    is_real = look.outer | look.inner
    assert int(is_real.sum()) > 60
    error = (found - expected).abs().amax(-1)[is_real]
    torch.testing.assert_close(error, torch.zeros_like(error), atol=1e-4, rtol=0)  # of up to 2000 px per metre


def test_edges_of_the_mesh_move_exactly(scene: Any, generator: torch.Generator) -> None:
    """In every direction, for the edges are carried by the skin."""
    camera, space = scene.camera(), named_pose_space("dof26")
    hand = load_hand_model().hand(dtype=torch.float64)
    contours = MeshContours(hand, camera, space.basis, points=60)
    free, reference = hands(scene, generator, space)
    look = contours.look(space.dof(free), reference, beyond_px=3.0)
    moved = numerical(contours, space, free, reference, look)
    motion = contours.motion(space.dof(free), reference, look)
    direction = torch.randn(moved.shape[:3], generator=generator, dtype=torch.float64)
    expected = (moved * direction[..., None]).sum(-2)
    torch.testing.assert_close(motion.along(direction), expected, atol=1e-4, rtol=0)
    torch.testing.assert_close(motion.points_px, look.points_px, atol=1e-9, rtol=0)


@pytest.mark.parametrize("kind", ["pinhole", "orthographic", "lens"])
@pytest.mark.parametrize("surface", ["primitives", "mesh"])
def test_springs_pull_as_rows_of_a_jacobian_do(surface: str, kind: str, scene: Any, generator: torch.Generator) -> None:
    """Normal equations in all DOFs against those of the rows, for two springs at every point."""
    camera = scene.camera("orthographic" if kind == "orthographic" else "pinhole", lens=5 if kind == "lens" else 0)
    space = named_pose_space("dof36")
    hand = load_hand_model().hand(dtype=torch.float64)
    contours = (
        MeshContours(hand, camera, space.basis, points=60)
        if surface == "mesh"
        else PrimitiveContours(scene.projector(camera), TABLE, space.basis)
    )
    pose, reference = hands(scene, generator, space)
    look = contours.look(pose, reference, beyond_px=3.0)
    motion = contours.motion(pose, reference, look)
    count = look.points_px.shape[1]
    direction = torch.randn(2, 2, 2, count, generator=generator, dtype=torch.float64)
    stiffness = torch.rand(2, 2, count, generator=generator, dtype=torch.float64)
    residual = torch.randn(2, 2, count, generator=generator, dtype=torch.float64)
    springs = Springs(direction=direction, stiffness=stiffness, pull=stiffness * residual)
    matrix, gradient = motion.equations(springs)
    rows = torch.cat([motion.along(part.mT) for part in direction.unbind(1)], 1)
    weighted = stiffness.flatten(1)[..., None] * rows
    scale = float((rows.mT @ weighted).abs().max())
    torch.testing.assert_close(matrix, rows.mT @ weighted, atol=1e-12 * scale, rtol=0)
    expected = (residual.flatten(1)[:, None] @ weighted).squeeze(1)
    torch.testing.assert_close(gradient, expected, atol=1e-12 * scale, rtol=0)


@pytest.mark.parametrize("surface", ["primitives", "mesh"])
def test_the_motion_at_the_look_is_that_of_its_pose(surface: str, scene: Any, generator: torch.Generator) -> None:
    contours = surfaces(scene)[surface]
    pose, reference = hands(scene, generator, named_pose_space("dof36"))
    look = contours.look(pose, reference, beyond_px=3.0)
    motion = contours.motion(pose, reference, look)
    is_real = look.outer | look.inner
    torch.testing.assert_close(look.points_px[is_real], motion.points_px[is_real], atol=1e-9, rtol=0)
    if look.motion is not None:
        torch.testing.assert_close(look.motion.columns_px, motion.columns_px, atol=1e-12, rtol=0)
        assert look.rows(torch.tensor([1])).motion is None


def facing_hand(scene: Any, name: str) -> tuple[Tensor, Tensor]:
    """Palm to the camera, upright."""
    pose = posture(name)
    pose[:3] = torch.tensor((0.0, 0.09, 0.5), dtype=torch.float64)
    reference = torch.tensor(((0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0)), dtype=torch.float64).T
    return pose[None], reference[None].contiguous()


def surfaces(scene: Any) -> dict[str, Contours]:
    space, camera = named_pose_space("dof26"), scene.camera(width=320, height=240)
    table = outline_table(10, 10, without=("palm_wrist",))
    return {
        "primitives": PrimitiveContours(scene.projector(camera), table, space.basis),
        "mesh": MeshContours(load_hand_model().hand(dtype=torch.float64), camera, space.basis),
    }


@pytest.mark.parametrize("surface", ["primitives", "mesh"])
def test_outer_points_have_the_hand_on_one_side_only(surface: str, scene: Any) -> None:
    contours = surfaces(scene)[surface]
    pose, reference = facing_hand(scene, "point")
    look = contours.look(pose, reference, beyond_px=3.0)
    mask = contours_mask(contours, pose, reference)
    outer, inner = look.outer[0], look.inner[0]
    assert int(outer.sum()) > 50
    assert int(inner.sum()) > 20  # fingers before the palm
    assert not bool((outer & inner).any())
    within = read(mask, look.points_px[0] - 2.5 * look.normals[0])
    beyond = read(mask, look.points_px[0] + 2.5 * look.normals[0])
    assert float(within[outer].double().mean()) > 0.97
    assert float(beyond[outer].double().mean()) < 0.03
    assert float(beyond[inner].double().mean()) > 0.9


def contours_mask(contours: Contours, pose: Tensor, reference: Tensor) -> Tensor:
    if isinstance(contours, PrimitiveContours):
        return contours.projector.silhouette(pose[0], reference[0])
    assert isinstance(contours, MeshContours)
    state = contours.hand(pose, root_reference=reference)
    return mesh_silhouette(state.vertices, state.faces, contours.camera, is_closed=True)[0]


def read(mask: Tensor, points_px: Tensor) -> Tensor:
    x, y = points_px.round().long().unbind(-1)
    return mask[y.clamp(0, mask.shape[0] - 1), x.clamp(0, mask.shape[1] - 1)]


@pytest.mark.parametrize("surface", ["primitives", "mesh"])
def test_hands_are_looked_at_one_by_one(surface: str, scene: Any, generator: torch.Generator) -> None:
    """Also beside hands that cannot be seen: not finite, or behind the camera."""
    contours = surfaces(scene)[surface]
    pose, reference = facing_hand(scene, "open")
    poses, references = pose.repeat(3, 1), reference.repeat(3, 1, 1)
    poses[0, 0] = torch.nan
    poses[1, 2] = -0.5
    look = contours.look(poses, references, beyond_px=3.0)
    alone = contours.look(pose, reference, beyond_px=3.0)
    assert not bool((look.outer[:2] | look.inner[:2]).any())
    assert torch.equal(look.outer[2], alone.outer[0])
    torch.testing.assert_close(look.points_px[2], alone.points_px[0], atol=1e-9, rtol=0)
    motion = contours.motion(poses, references, look)
    assert bool(motion.along(look.normals.nan_to_num())[2].isfinite().all())
    torch.testing.assert_close(look.rows(torch.tensor([2])).points_px[0], look.points_px[2])


def test_wrist_and_fingers_are_told(scene: Any) -> None:
    contours = surfaces(scene)["primitives"]
    pose, reference = facing_hand(scene, "open")
    look = contours.look(pose, reference, beyond_px=3.0)
    expected = contours.camera.project(contours.kinematics(pose, root_reference=reference).keypoints[0])
    torch.testing.assert_close(look.wrist_px[0], expected[0])
    torch.testing.assert_close(look.fingerwards_px[0], expected[9] - expected[0])


def test_irregular_tables_are_refused(scene: Any) -> None:
    keep = torch.ones(TABLE.size, dtype=torch.bool)
    keep[3] = False
    with pytest.raises(ValueError, match="equally many points"):
        OutlineTracer(scene.projector(scene.camera()), TABLE.select(keep), torch.eye(len(DOFS), dtype=torch.float64))


def test_open_meshes_are_refused(scene: Any) -> None:
    hand = load_hand_model().hand(dtype=torch.float64)
    hand.faces = hand.faces[:-1]
    with pytest.raises(ValueError, match="closed mesh"):
        MeshContours(hand, scene.camera(), torch.eye(len(DOFS), dtype=torch.float64))
    with pytest.raises(ValueError, match="points: expected 1 or more"):
        MeshContours(load_hand_model().hand(), scene.camera(), torch.eye(36), points=0)
