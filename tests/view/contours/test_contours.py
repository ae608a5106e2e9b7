"""Contours: their motion against finite differences, which points are outer and which inner."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.geometry import rotation_from_vector
from torchhand.hand import HandPose, PoseSpace, named_pose_space, posture
from torchhand.view.contours.contours import Contours, PrimitiveContours, VisibleContour
from torchhand.view.contours.jacobian import OutlineTracer
from torchhand.view.contours.mesh_contours import MeshContours
from torchhand.view.contours.terms import PointToLineTerms
from torchhand.view.outlines import outline_table
from torchhand.view.raster import mesh_silhouette

STEP = 1e-6
TABLE = outline_table(4, 5, without=("palm_wrist",))


def numerical(contours: Contours, space: PoseSpace, hand: HandPose, visible: VisibleContour) -> Tensor:
    """d points / d free by central differences: hands, points, 2, free."""
    columns, free = [], space.free(hand.dofs)
    for i in range(space.size):
        step = torch.zeros(space.size, dtype=free.dtype)
        step[i] = STEP
        ends = [
            contours.points(HandPose.of(space.dof(free + sign * step), hand.reference), visible).mT for sign in (1, -1)
        ]
        columns.append((ends[0] - ends[1]) / (2 * STEP))
    return torch.stack(columns, -1)


def hands(scene: Any, generator: torch.Generator, space: PoseSpace, count: int = 2) -> HandPose:
    """In the pose space, with rotation vectors on top of references that differ."""
    pose, reference = scene.pose(generator, count)
    references = rotation_from_vector(0.2 * torch.randn(count, 3, generator=generator).double()) @ reference
    return HandPose.of(space.dof(space.free(pose)), references)


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
    contours = PrimitiveContours(scene.projector(camera, "left" if kind == "moved" else "right"), TABLE)
    hand = hands(scene, generator, space)
    visible = contours.visible(hand, probe_distance_px=3.0)
    expected = (numerical(contours, space, hand, visible) * visible.normals[..., None]).sum(-2)
    found = contours.motion(hand, visible).slopes(visible.normals.mT[:, None]).squeeze(1) @ space.basis
    # A point whose generator vanishes jumps: leave out what does not move smoothly.
    is_real = visible.outer | visible.inner
    assert int(is_real.sum()) > 60
    error = (found - expected).abs().amax(-1)[is_real]
    torch.testing.assert_close(error, torch.zeros_like(error), atol=1e-4, rtol=0)  # of up to 2000 px per metre


def test_edges_of_the_mesh_move_exactly(scene: Any, generator: torch.Generator) -> None:
    """In every direction, for the edges are carried by the skin."""
    camera, space = scene.camera(), named_pose_space("dof26")
    contours = MeshContours(load_hand_model().hand(dtype=torch.float64), camera, max_points=60)
    hand = hands(scene, generator, space)
    visible = contours.visible(hand, probe_distance_px=3.0)
    moved = numerical(contours, space, hand, visible)
    motion = contours.motion(hand, visible)
    direction = torch.randn(moved.shape[:3], generator=generator, dtype=torch.float64)
    expected = (moved * direction[..., None]).sum(-2)
    found = motion.slopes(direction.mT[:, None]).squeeze(1) @ space.basis
    torch.testing.assert_close(found, expected, atol=1e-4, rtol=0)
    torch.testing.assert_close(motion.columns_px.mT, visible.points_px, atol=1e-9, rtol=0)


@pytest.mark.parametrize("kind", ["pinhole", "orthographic", "lens"])
@pytest.mark.parametrize("surface", ["primitives", "mesh"])
def test_terms_add_up_as_rows_of_a_jacobian_do(surface: str, kind: str, scene: Any, generator: torch.Generator) -> None:
    """Normal equations in all DOFs against those of the rows, for two terms at every point."""
    camera = scene.camera("orthographic" if kind == "orthographic" else "pinhole", lens=5 if kind == "lens" else 0)
    contours = (
        MeshContours(load_hand_model().hand(dtype=torch.float64), camera, max_points=60)
        if surface == "mesh"
        else PrimitiveContours(scene.projector(camera), TABLE)
    )
    hand = hands(scene, generator, named_pose_space("dof36"))
    motion = contours.motion(hand, contours.visible(hand, probe_distance_px=3.0))
    count = motion.columns_px.shape[2]
    direction = torch.randn(2, 2, 2, count, generator=generator, dtype=torch.float64)
    curvature = torch.rand(2, 2, count, generator=generator, dtype=torch.float64)
    residual = torch.randn(2, 2, count, generator=generator, dtype=torch.float64)
    terms = PointToLineTerms(direction=direction, curvature=curvature, gradient=curvature * residual)
    matrix, gradient = motion.equations(terms)
    rows = motion.slopes(direction).flatten(1, 2)
    weighted = curvature.flatten(1)[..., None] * rows
    scale = float((rows.mT @ weighted).abs().max())
    torch.testing.assert_close(matrix, rows.mT @ weighted, atol=1e-12 * scale, rtol=0)
    expected = (residual.flatten(1)[:, None] @ weighted).squeeze(1)
    torch.testing.assert_close(gradient, expected, atol=1e-12 * scale, rtol=0)


@pytest.mark.parametrize("surface", ["primitives", "mesh"])
def test_the_motion_at_hand_is_that_of_the_pose(surface: str, scene: Any, generator: torch.Generator) -> None:
    contours = surfaces(scene)[surface]
    hand = hands(scene, generator, named_pose_space("dof36"))
    visible = contours.visible(hand, probe_distance_px=3.0)
    motion = contours.motion(hand, visible)
    is_real = visible.outer | visible.inner
    torch.testing.assert_close(visible.points_px[is_real], motion.columns_px.mT[is_real], atol=1e-9, rtol=0)
    torch.testing.assert_close(contours.points(hand, visible), motion.columns_px, atol=1e-9, rtol=0)
    if visible.motion is not None:
        torch.testing.assert_close(visible.motion.columns_px, motion.columns_px, atol=1e-12, rtol=0)
        assert visible.rows(torch.tensor([1])).motion is None


@pytest.mark.parametrize("surface", ["primitives", "mesh"])
def test_contours_of_another_shape(surface: str, scene: Any) -> None:
    """As if made with it; the first are left as they are."""
    contours, hand = surfaces(scene)[surface], facing_hand(scene, "open")
    before = contours.visible(hand)
    shape = contours.shape * 1.1
    other = contours.with_shape(shape)
    assert torch.equal(other.shape, shape)
    keypoints = contours.kinematics(hand.dofs, shape, root_reference=hand.reference).keypoints
    wrist = contours.camera.project(keypoints)[:, 0]
    torch.testing.assert_close(other.visible(hand).wrist_px, wrist)
    mask = contours_mask(other, hand)
    found = other.visible(hand, probe_distance_px=3.0)
    outer = found.outer[0]
    within = read(mask, found.points_px[0] - 2.5 * found.normals[0])[outer].double().mean()
    beyond = read(mask, found.points_px[0] + 2.5 * found.normals[0])[outer].double().mean()
    assert float(within) > 0.97
    assert float(beyond) < 0.03
    assert torch.equal(contours.visible(hand).points_px, before.points_px)


def facing_hand(scene: Any, name: str) -> HandPose:
    """Palm to the camera, upright."""
    pose = posture(name, dtype=torch.float64)
    pose[:3] = torch.tensor((0.0, 0.09, 0.5), dtype=torch.float64)
    reference = torch.tensor(((0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0)), dtype=torch.float64).T
    return HandPose.of(pose[None], reference.contiguous())


def surfaces(scene: Any) -> dict[str, Contours]:
    camera = scene.camera(width=320, height=240)
    table = outline_table(10, 10, without=("palm_wrist",))
    return {
        "primitives": PrimitiveContours(scene.projector(camera), table),
        "mesh": MeshContours(load_hand_model().hand(dtype=torch.float64), camera),
    }


@pytest.mark.parametrize("surface", ["primitives", "mesh"])
def test_outer_points_have_the_hand_on_one_side_only(surface: str, scene: Any) -> None:
    contours, hand = surfaces(scene)[surface], facing_hand(scene, "point")
    found = contours.visible(hand, probe_distance_px=3.0)
    mask = contours_mask(contours, hand)
    outer, inner = found.outer[0], found.inner[0]
    assert int(outer.sum()) > 50
    assert int(inner.sum()) > 20  # fingers before the palm
    assert not bool((outer & inner).any())
    within = read(mask, found.points_px[0] - 2.5 * found.normals[0])
    beyond = read(mask, found.points_px[0] + 2.5 * found.normals[0])
    assert float(within[outer].double().mean()) > 0.97
    assert float(beyond[outer].double().mean()) < 0.03
    assert float(beyond[inner].double().mean()) > 0.9


@pytest.mark.parametrize("surface", ["primitives", "mesh"])
def test_every_hand_has_a_probe_distance_of_its_own(surface: str, scene: Any) -> None:
    contours, hand = surfaces(scene)[surface], facing_hand(scene, "open")
    distances = torch.tensor((2.0, 9.0), dtype=torch.float64)
    both = contours.visible(hand.expand(2), probe_distance_px=distances)
    for i, distance in enumerate(distances.tolist()):
        alone = contours.visible(hand, probe_distance_px=distance)
        assert torch.equal(both.outer[i], alone.outer[0])
    assert int(both.outer[1].sum()) < int(both.outer[0].sum())  # between the fingers there is little room


def test_points_stand_for_lengths_that_do_not_depend_on_their_number(scene: Any) -> None:
    hand = facing_hand(scene, "fist")
    projector = scene.projector(scene.camera())
    totals = []
    for points in (6, 24):
        visible = PrimitiveContours(projector, outline_table(points, points, without=("palm_wrist",))).visible(hand)
        totals.append(torch.stack([(visible.length_px * which).sum(-1) for which in (visible.outer, visible.inner)]))
    torch.testing.assert_close(totals[0], totals[1], atol=0, rtol=0.1)


def test_a_point_of_a_mesh_stands_for_its_edge(scene: Any) -> None:
    hand, contours = facing_hand(scene, "fist"), surfaces(scene)["mesh"]
    visible = contours.visible(hand)
    assert visible.edges is not None
    assert isinstance(contours, MeshContours)
    vertices = contours.hand(hand.dofs, contours.shape, root_reference=hand.reference).vertices
    ends = contours.camera.project(vertices[0, visible.edges[0]])
    is_point = visible.outer[0] | visible.inner[0]
    length = (ends[:, 1] - ends[:, 0]).norm(dim=-1)
    torch.testing.assert_close(visible.length_px[0, is_point], length[is_point])


def contours_mask(contours: Contours, hand: HandPose) -> Tensor:
    if isinstance(contours, PrimitiveContours):
        return contours.projector.silhouette(hand.dofs[0], hand.reference[0])
    assert isinstance(contours, MeshContours)
    state = contours.hand(hand.dofs, contours.shape, root_reference=hand.reference)
    return mesh_silhouette(state.vertices, state.faces, contours.camera, is_closed=True)[0]


def read(mask: Tensor, points_px: Tensor) -> Tensor:
    x, y = points_px.round().long().unbind(-1)
    return mask[y.clamp(0, mask.shape[0] - 1), x.clamp(0, mask.shape[1] - 1)]


@pytest.mark.parametrize("surface", ["primitives", "mesh"])
def test_hands_do_not_touch_each_other(surface: str, scene: Any) -> None:
    """Also beside hands that cannot be seen: not finite, or behind the camera."""
    contours, hand = surfaces(scene)[surface], facing_hand(scene, "open")
    dofs = hand.dofs.repeat(3, 1)
    dofs[0, 0] = torch.nan
    dofs[1, 2] = -0.5
    several = HandPose.of(dofs, hand.reference)
    found = contours.visible(several, probe_distance_px=3.0)
    alone = contours.visible(hand, probe_distance_px=3.0)
    assert not bool((found.outer[:2] | found.inner[:2]).any())
    assert torch.equal(found.outer[2], alone.outer[0])
    torch.testing.assert_close(found.points_px[2], alone.points_px[0], atol=1e-9, rtol=0)
    motion = contours.motion(several, found)
    assert bool(motion.slopes(found.normals.mT[:, None].nan_to_num())[2].isfinite().all())
    torch.testing.assert_close(found.rows(torch.tensor([2])).points_px[0], found.points_px[2])


def test_wrist_and_fingers_are_told(scene: Any) -> None:
    contours, hand = surfaces(scene)["primitives"], facing_hand(scene, "open")
    found = contours.visible(hand, probe_distance_px=3.0)
    keypoints = contours.kinematics(hand.dofs, root_reference=hand.reference).keypoints
    expected = contours.camera.project(keypoints[0])
    torch.testing.assert_close(found.wrist_px[0], expected[0])
    torch.testing.assert_close(found.distal_px[0], expected[9] - expected[0])


def test_irregular_tables_are_refused(scene: Any) -> None:
    keep = torch.ones(TABLE.size, dtype=torch.bool)
    keep[3] = False
    with pytest.raises(ValueError, match="equally many points"):
        OutlineTracer(scene.projector(scene.camera()), TABLE.select(keep))


def test_meshes_that_have_no_contours_are_refused(scene: Any) -> None:
    hand = load_hand_model().hand(dtype=torch.float64)
    with pytest.raises(ValueError, match="max_points: expected 1 or more"):
        MeshContours(hand, scene.camera(), max_points=0)
    seen = surfaces(scene)["primitives"].visible(facing_hand(scene, "open"))
    with pytest.raises(ValueError, match="visible: expected the contour of a mesh"):
        MeshContours(hand, scene.camera()).points(facing_hand(scene, "open"), seen)
    hand.faces = hand.faces[:-1]
    with pytest.raises(ValueError, match="closed mesh"):
        MeshContours(hand, scene.camera())
