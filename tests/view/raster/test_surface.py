"""Primitives and mesh behind one interface."""

import itertools
from dataclasses import replace
from typing import Any

import pytest
import torch

from torchhand.files import load_hand_model
from torchhand.geometry import Camera, rotation_from_vector
from torchhand.hand import BONES, PRIMITIVE_NAMES, PosedMesh, Primitives, posed_mesh, posture
from torchhand.view.raster.raster import rasterize
from torchhand.view.raster.raycast import raycast, shade
from torchhand.view.raster.surface import Surface, cast, silhouette

BACK = torch.tensor(((0.0, 0.0, -1.0), (0.0, -1.0, 0.0), (-1.0, 0.0, 0.0)), dtype=torch.float64).T.contiguous()


def _surfaces(*batch: int, side: str = "right") -> tuple[Primitives, PosedMesh]:
    """Primitives and mesh of the same hands."""
    hand = load_hand_model().hand(side="left" if side == "left" else "right", dtype=torch.float64)
    pose = posture("open", dtype=torch.float64).expand(*batch, -1).clone()
    pose[..., :3] = torch.tensor((0.0, 0.09, 0.5))
    pose[..., 3:6] = 0.3 * torch.randn(*batch, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    state = hand(pose, root_reference=BACK)
    return state.primitives, posed_mesh(hand, state)


def _turned(camera: Camera) -> Camera:
    turn = rotation_from_vector(torch.tensor((0.02, -0.03, 0.4), dtype=torch.float64))
    return replace(camera, rotation=turn, translation=torch.tensor((0.01, -0.02, 0.03), dtype=torch.float64))


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize(("kind", "lens"), [("pinhole", 0), ("pinhole", 5), ("orthographic", 0)])
def test_both_show_the_same_hand(kind: str, lens: int, side: str, scene: Any) -> None:
    camera = _turned(scene.camera(kind, lens=lens))
    seen = [cast(surface, camera) for surface in _surfaces(side=side)]
    both, either = seen[0].mask & seen[1].mask, seen[0].mask | seen[1].mask
    assert int(both.sum()) > 0.9 * int(either.sum()) > 500
    gap = (seen[0].depth - seen[1].depth)[both].abs()
    assert float(gap.median()) < 3e-3
    alike = (seen[0].normal * seen[1].normal).sum(-1)[both]
    assert float(alike.median()) > 0.95
    assert int(seen[0].part.max()) < len(PRIMITIVE_NAMES)
    names = {BONES[int(part)] for part in seen[1].part.unique() if part >= 0}
    assert {"index_distal", "middle_middle", "thumb_distal"} <= names
    pictures = [shade(record).double() for record in seen]
    assert float((pictures[0] - pictures[1])[both].abs().mean()) < 12


def test_a_mesh_is_drawn_with_smooth_normals_and_its_bones(scene: Any) -> None:
    camera, (_, mesh) = scene.camera(width=640, height=480), _surfaces()
    seen = cast(mesh, camera)
    plain = rasterize(mesh.vertices, mesh.faces, camera, mesh.part_of_face)
    assert torch.equal(seen.mask, plain.mask)
    assert torch.equal(seen.part, plain.part)
    torch.testing.assert_close(seen.depth, plain.depth)
    inside = seen.mask[:, 1:] & seen.mask[:, :-1]
    same = [
        float((record.normal.diff(dim=1).abs().amax(-1) < 1e-12)[inside].double().mean()) for record in (seen, plain)
    ]
    assert same[0] < 0.001
    assert same[1] > 0.3


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_silhouettes_are_the_masks_of_casts(batch: tuple[int, ...], scene: Any) -> None:
    camera = _turned(scene.camera(width=64, height=48))
    for surface in _surfaces(*batch):
        masks = silhouette(surface, camera)
        assert masks.shape == (*batch, 48, 64)
        for index in itertools.product(*map(range, batch)):
            alone: Surface = surface
            for i in index:
                alone = alone.select(i)
            assert torch.equal(masks[index], cast(alone, camera).mask)
        assert bool(masks.any())


def test_moved_surfaces_look_like_a_moved_camera(scene: Any) -> None:
    camera = scene.camera(width=64, height=48)
    turned = _turned(camera)
    for surface in _surfaces():
        moved = cast(surface.moved(turned.rotation, turned.translation), camera)
        torch.testing.assert_close(moved.depth, cast(surface, turned).depth)


def test_shapes_that_only_some_dimensions_have(scene: Any) -> None:
    """Two shapes, each in three poses: the sizes of the primitives have fewer dimensions filled than their places."""
    model, camera = load_hand_model(), scene.camera(width=64, height=48)
    hand = model.hand(dtype=torch.float64)
    shapes = torch.stack((model.shape_space.default, 1.1 * model.shape_space.default))[:, None]
    poses = posture("open", dtype=torch.float64).repeat(3, 1)
    poses[:, :3] = torch.tensor(((0.0, 0.09, 0.5), (0.0, 0.09, 0.6), (0.05, 0.09, 0.5)))
    primitives = hand(poses, shapes, root_reference=BACK).primitives
    masks = silhouette(primitives, camera)
    for i in range(2):
        for j in range(3):
            alone = hand(poses[j], shapes[i, 0], root_reference=BACK).primitives
            assert torch.equal(masks[i, j], raycast(alone, camera).mask)
