"""Soft silhouettes and depth: areas, and their derivatives against differences of finely sampled pictures."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.geometry import Camera, assumed_camera, rotation_from_vector
from torchhand.hand import Hand, posed_mesh
from torchhand.view.raster import cast, silhouette
from torchhand.view.soft import SoftRenderer, primitive_mesh

FINER = 8  # samples along each side of a pixel, of what pictures are compared with
Box = tuple[Tensor, Tensor]
"""Corners and faces."""


@pytest.fixture(scope="module")
def hand() -> Hand:
    return load_hand_model().hand(dtype=torch.float64)


def hands(count: int, seed: int = 0) -> tuple[Tensor, Tensor]:
    """Poses before the camera, turned any way, and shapes, both of the prior."""
    generator = torch.Generator().manual_seed(seed)
    poses, shapes = load_hand_model().prior(dtype=torch.float64).sample(count, generator)
    poses[:, 3:6] = 1.5 * torch.randn(count, 3, generator=generator, dtype=torch.float64)
    middle = load_hand_model().kinematics(dtype=torch.float64)(poses).keypoints.mean(1)
    poses[:, :3] = torch.tensor((0.0, 0.0, 0.5), dtype=torch.float64) - middle
    return poses, shapes


@pytest.fixture(scope="module")
def box() -> Box:
    """A cube of a metre."""
    corners = torch.tensor([(x, y, z) for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)]).double()
    faces = [(0, 1, 3), (0, 3, 2), (4, 7, 5), (4, 6, 7), (0, 5, 1), (0, 4, 5), (2, 3, 7), (2, 7, 6), (0, 2, 6)]
    return corners, torch.tensor([*faces, (0, 6, 4), (1, 5, 7), (1, 7, 3)])


def sampled(mask: Tensor) -> Tensor:
    """Shares of pixels, of masks that are finer."""
    return torch.nn.functional.avg_pool2d(mask.double()[:, None], FINER)[:, 0]


@pytest.mark.parametrize(("kind", "lens"), [("pinhole", 0), ("pinhole", 5), ("orthographic", 0)])
def test_silhouettes_are_those_of_many_rays_a_pixel(kind: str, lens: int, hand: Hand, scene: Any) -> None:
    camera: Camera = scene.camera(kind, width=96, height=80, lens=lens)
    state = hand(*hands(2))
    renderer = SoftRenderer(hand.faces)
    own = renderer.silhouette(state.vertices, camera)
    rays = sampled(silhouette(posed_mesh(hand, state), camera.resized(float(FINER))))
    torch.testing.assert_close(own, rays, atol=0.15, rtol=0)  # of 64 rays, and where outlines cross
    assert float((own - rays).abs().sum() / rays.sum()) < 4e-3
    torch.testing.assert_close(own.sum((1, 2)), rays.sum((1, 2)), rtol=2e-3, atol=0)
    flipped = replace(camera, intrinsics=camera.intrinsics * torch.tensor((-1.0, 1.0, 1.0))[:, None])
    flipped.intrinsics[0, 2] = camera.width - 1 - camera.intrinsics[0, 2]
    if lens == 0:
        torch.testing.assert_close(renderer.silhouette(state.vertices, flipped).flip(-1), own)


def test_primitives_have_the_silhouettes_that_rays_have(hand: Hand, scene: Any) -> None:
    camera = scene.camera(width=96, height=80)
    primitives = hand(*hands(2)).primitives
    vertices, faces = primitive_mesh(primitives)
    own = SoftRenderer(faces).silhouette(vertices, camera)
    rays = sampled(silhouette(primitives, camera.resized(float(FINER))))
    torch.testing.assert_close(own.sum((1, 2)), rays.sum((1, 2)), rtol=3e-3, atol=0)
    assert float((own - rays).abs().sum() / rays.sum()) < 0.01


def test_a_square_covers_what_it_covers_and_moves_as_it_moves(box: Box, scene: Any) -> None:
    """A box before an orthographic camera of one pixel a metre: pixels by hand."""
    corner, faces = box
    camera = replace(
        scene.camera("orthographic", width=6, height=5), intrinsics=torch.eye(3, dtype=torch.float64), width=6, height=5
    )
    sides = torch.tensor((2.5, 1.25, 1.0)).double().requires_grad_()
    place = torch.tensor((0.75, 1.0, 2.0)).double().requires_grad_()
    covered = SoftRenderer(faces).silhouette(corner * sides + place, camera)
    columns, rows = torch.tensor((0, 0.75, 1, 0.75, 0, 0)).double(), torch.tensor((0, 0.5, 0.75, 0, 0)).double()
    torch.testing.assert_close(covered, rows[:, None] * columns)
    by_sides, by_place = torch.autograd.grad(covered.sum(), (sides, place), retain_graph=True)
    torch.testing.assert_close(by_sides, torch.tensor((1.25, 2.5, 0.0)).double())
    torch.testing.assert_close(by_place, torch.zeros(3).double())
    (by_place,) = torch.autograd.grad(covered[:, 3].sum(), place)
    torch.testing.assert_close(by_place, torch.tensor((1.25, 0.0, 0.0)).double())


def test_derivatives_of_areas_are_those_of_finite_differences(hand: Hand, scene: Any) -> None:
    """In the root, some joints, the shape and the camera; of the areas of pictures of eight times the size."""
    camera = scene.camera(width=96, height=80)
    poses, shapes = hands(6, seed=1)
    turn = torch.zeros(3, dtype=torch.float64)
    renderer = SoftRenderer(hand.faces)

    def area(poses: Tensor, shapes: Tensor, turn: Tensor, focal: Tensor, scale: float = 1.0) -> Tensor:
        intrinsics = camera.intrinsics * torch.stack((focal, focal, focal / focal))[:, None]
        seen = replace(camera, intrinsics=intrinsics, rotation=rotation_from_vector(turn)).resized(scale)
        return renderer.silhouette(hand(poses, shapes).vertices, seen)[..., 1:-1, 1:-1].sum((1, 2)) / scale**2

    values = (poses, shapes, turn, torch.ones((), dtype=torch.float64))
    leaves = [value.clone().requires_grad_() for value in values]
    whole = area(leaves[0], leaves[1], leaves[2], leaves[3])
    grads = torch.autograd.grad(whole.sum(), leaves)
    for which, column, step in ((0, 2, 2e-3), (0, 3, 2e-3), (0, 5, 2e-3), (0, 8, 2e-3), (0, 14, 2e-3), (1, 0, 3e-3)):
        change = torch.zeros_like(values[which])
        change[..., column] = step
        with torch.no_grad():
            ends = []
            for sign in (1, -1):
                a, b, c, d = (v + sign * change if i == which else v for i, v in enumerate(values))
                ends.append(area(a, b, c, d, float(FINER)))
        slope = (ends[0] - ends[1]) / (2 * step)
        assert float((grads[which][:, column] - slope).norm() / slope.norm()) < 0.01, (which, column)
    with torch.no_grad():
        wider, narrower = (
            area(poses, shapes, turn, torch.tensor(f).double(), scale=float(FINER)) for f in (1.002, 0.998)
        )
    torch.testing.assert_close(grads[3], ((wider - narrower) / 4e-3).sum(), rtol=0.01, atol=0)


def place(count: int, seed: int) -> tuple[Tensor, Tensor, Camera]:
    """Hands whose fingers cross in the picture, every other of which leaves it at the left or at the top."""
    poses, shapes = hands(count, seed=seed)
    poses[1::2, 0] -= 0.08
    poses[1::4, 1] -= 0.06
    return poses, shapes, assumed_camera(64, 64, horizontal_fov_deg=25.0)


def test_derivatives_are_those_of_the_pictures_themselves(hand: Hand) -> None:
    """Of weighted sums of pixels, over steps of a micrometre and a microradian: what is drawn has no jumps."""
    poses, shapes, camera = place(8, seed=3)
    renderer = SoftRenderer(hand.faces)
    weights = torch.randn(64, 64, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    leaf = poses.clone().requires_grad_()
    (grad,) = torch.autograd.grad((weights * renderer.silhouette(hand(leaf, shapes).vertices, camera)).sum(), leaf)
    for column in (0, 1, 2, 3, 5, 8, 14, 20):
        change = torch.zeros_like(poses)
        change[:, column] = 1e-6
        with torch.no_grad():
            ends = [renderer.silhouette(hand(poses + by, shapes).vertices, camera) for by in (change, -change)]
        slope = ((ends[0] - ends[1]) * weights).sum((1, 2)) / 2e-6
        assert float((grad[:, column] - slope).norm() / slope.norm()) < 1e-3, column


def test_a_pixel_is_covered_as_the_pixels_of_a_finer_picture_are(hand: Hand) -> None:
    poses, shapes, camera = place(6, seed=4)
    state = hand(poses, shapes)
    for (vertices, faces), near in (((state.vertices, hand.faces), 1e-9), (primitive_mesh(state.primitives), 5e-3)):
        renderer = SoftRenderer(faces)
        with torch.no_grad():
            own, finer = (renderer.silhouette(vertices, one) for one in (camera, camera.resized(float(FINER))))
        mean = torch.nn.functional.avg_pool2d(finer[:, None], FINER)[:, 0]
        torch.testing.assert_close(own, mean, atol=near, rtol=0)


def test_single_precision_has_the_pictures_and_derivatives_of_double_precision(hand: Hand) -> None:
    poses, shapes, camera = place(8, seed=5)
    vertices, weights = hand(poses, shapes).vertices, torch.randn(64, 64, generator=torch.Generator().manual_seed(0))
    found = []
    for dtype in (torch.float32, torch.float64):
        leaf = vertices.float().to(dtype).requires_grad_()
        covered = SoftRenderer(hand.faces).silhouette(leaf, camera.to(dtype=dtype))
        assert covered.dtype == dtype
        (grad,) = torch.autograd.grad((weights.to(dtype) * covered).sum(), leaf)
        found.append((covered.detach().double(), grad.double()))
    torch.testing.assert_close(found[0][0], found[1][0], atol=2e-4, rtol=0)
    assert float((found[0][1] - found[1][1]).norm() / found[1][1].norm()) < 1e-3


@pytest.mark.parametrize("shift", [0.0, 0.25, 1.0])
def test_boxes_that_touch_or_overlap_cover_their_union(shift: float, box: Box, scene: Any) -> None:
    """Two boxes of 2 by 1.25 m, one pixel a metre, with a side in common or an overlap; across the left border too."""
    corners, faces = box
    camera = replace(
        scene.camera("orthographic", width=6, height=5), intrinsics=torch.eye(3, dtype=torch.float64), width=6, height=5
    )
    for left in (1.0, -2.5):
        first = corners * torch.tensor((2.0, 1.25, 1.0)).double() + torch.tensor((left, 1.0, 2.0)).double()
        other = first + torch.tensor((2.0 - shift, 0.5 if shift else 0.0, 0.0)).double()
        renderer = SoftRenderer(torch.cat((faces, faces + len(corners))))
        covered = renderer.silhouette(torch.cat((first, other)), camera)
        finer = torch.zeros(5 * 8, 6 * 8, dtype=torch.bool)
        y, x = torch.meshgrid(*((torch.arange(n * 8) + 0.5) / 8 - 0.5 for n in (5, 6)), indexing="ij")
        for one in (first, other):
            (low_x, low_y), (high_x, high_y) = one[:, :2].amin(0), one[:, :2].amax(0)
            finer |= (x > low_x) & (x < high_x) & (y > low_y) & (y < high_y)
        torch.testing.assert_close(covered, sampled(finer[None])[0])


def test_depth_is_the_mean_of_what_rays_meet(hand: Hand, scene: Any) -> None:
    camera = scene.camera(width=96, height=80)
    state = hand(*hands(2))
    picture = SoftRenderer(hand.faces).picture(state.vertices, camera)
    for index in range(2):
        rays = cast(posed_mesh(hand, state).select(index), camera.resized(float(FINER))).depth
        hits = sampled(rays.isfinite()[None])[0]
        mean = sampled(rays.nan_to_num(posinf=0.0)[None])[0] / hits.clamp_min(1e-9)
        error = (picture.depth[index] - mean)[hits > 0].abs()
        assert float(error.mean()) < 6e-4
        assert float(error.median()) < 2e-4
    assert (picture.depth[picture.coverage > 1e-6] > 0).all()
    assert (picture.depth[picture.coverage == 0] == 0).all()


def test_derivatives_of_depth_are_those_of_finite_differences(hand: Hand, scene: Any) -> None:
    """Of its integral over the pictures, weighted from place to place; hidden edges included."""
    camera = scene.camera(width=96, height=80)
    poses, shapes = hands(6, seed=2)
    renderer = SoftRenderer(hand.faces)
    weights = torch.randn(1, 1, 6, 6, generator=torch.Generator().manual_seed(0), dtype=torch.float64)

    def amount(poses: Tensor, scale: float = 1.0) -> Tensor:
        seen = camera.resized(scale)
        picture = renderer.picture(hand(poses, shapes).vertices, seen)
        weight = torch.nn.functional.interpolate(weights, size=(seen.height, seen.width), mode="bilinear")[0, 0]
        return (picture.coverage * picture.depth * weight).sum((1, 2)) / scale**2

    leaf = poses.clone().requires_grad_()
    (grad,) = torch.autograd.grad(amount(leaf).sum(), leaf)
    for column, step in ((0, 1e-3), (2, 2e-3), (8, 1e-2), (14, 1e-2)):
        change = torch.zeros_like(poses)
        change[:, column] = step
        with torch.no_grad():
            slope = (amount(poses + change, 4.0) - amount(poses - change, 4.0)) / (2 * step)
        assert float((grad[:, column] - slope).norm() / slope.norm()) < 0.05, column


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_any_batch_of_hands_and_cameras(batch: tuple[int, ...], hand: Hand, scene: Any) -> None:
    camera = scene.camera(width=48, height=40)
    poses, _ = hands(6)
    vertices = hand(poses).vertices[: max(1, 6 if batch == (2, 3) else 1)].reshape(*batch, -1, 3)
    renderer = SoftRenderer(hand.faces)
    one_by_one = torch.stack([renderer.silhouette(own, camera) for own in vertices.reshape(-1, *vertices.shape[-2:])])
    torch.testing.assert_close(renderer.silhouette(vertices, camera), one_by_one.reshape(*batch, 40, 48))
    many = replace(
        camera,
        **{
            n: getattr(camera, n).expand(*batch, *getattr(camera, n).shape)
            for n in ("rotation", "translation", "distortion")
        },
        intrinsics=camera.intrinsics.expand(*batch, 3, 3),
    )
    torch.testing.assert_close(renderer.silhouette(vertices, many), one_by_one.reshape(*batch, 40, 48))


def test_what_is_behind_the_camera_or_beside_the_picture_does_no_harm(hand: Hand, scene: Any) -> None:
    camera, (poses, _) = scene.camera(width=48, height=40), hands(3)
    poses[0, 2] -= 0.5  # around the camera
    poses[1, 2] -= 1.5  # behind it
    poses[2, 0] += 5.0  # beside the picture
    leaf = poses.requires_grad_()
    picture = SoftRenderer(hand.faces).picture(hand(leaf).vertices, camera)
    (picture.coverage + picture.depth).sum().backward()
    assert picture.coverage.isfinite().all()
    assert picture.depth.isfinite().all()
    assert leaf.grad is not None
    assert leaf.grad.isfinite().all()
    assert picture.coverage[1:].abs().sum() == 0


def test_meshes_with_holes_are_refused(hand: Hand) -> None:
    with pytest.raises(ValueError, match="faces: expected a closed mesh"):
        SoftRenderer(hand.faces[1:])
    turned = hand.faces.clone()
    turned[0] = turned[0].flip(0)
    with pytest.raises(ValueError, match="go round the same way"):
        SoftRenderer(turned)
