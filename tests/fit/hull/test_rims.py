"""Rays through the edges of silhouettes, and the fit to them."""

import math
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from torchhand.fit import Expectation
from torchhand.fit.hull.fit import HullFitter, HullStatus
from torchhand.fit.hull.points import with_rims
from torchhand.fit.hull.rims import HullRims, rims_of
from torchhand.fit.hull.settings import HULL_TRACKING_LEVELS, HullFitSettings
from torchhand.geometry import Camera, vector_from_rotation
from torchhand.hand import DOFS, named_pose_space, rebased

SPACE = named_pose_space("dof28")
CENTRE, RADIUS = torch.tensor((0.02, -0.01, 0.03), dtype=torch.float64), 0.06


def ball(camera: Camera) -> Tensor:
    """Its silhouette, by each pixel's ray, near where it is."""
    left, top = (int(value) - 110 for value in camera.project(CENTRE))
    y, x = torch.meshgrid(torch.arange(top, top + 220), torch.arange(left, left + 220), indexing="ij")
    origin, along = camera.rays(torch.stack((x, y), -1).double())
    along = along / along.norm(dim=-1, keepdim=True)
    apart = camera.cam_from_world(CENTRE) - origin
    mask = torch.zeros(480, 640, dtype=torch.bool)
    mask[y, x] = (apart - (apart * along).sum(-1, keepdim=True) * along).norm(dim=-1) < RADIUS
    return mask


def rays_of(rig: Any, cameras: tuple[Camera, ...], count: int = 200) -> HullRims:
    found = rims_of(cameras, [ball(camera) for camera in cameras], CENTRE, count=count)
    assert found is not None
    return found


@pytest.mark.parametrize("kind", ["perspective", "distorted", "orthographic"])
def test_rays_touch_the_object(rig: Any, kind: str) -> None:
    cameras = rig.cameras
    if kind == "distorted":
        bent = torch.tensor((-0.2, 0.05, 0.001, -0.002, 0.0), dtype=torch.float64)
        cameras = tuple(replace(camera, distortion=bent) for camera in cameras)
    if kind == "orthographic":
        scaled = torch.tensor(((1300.0, 0, 319.5), (0, 1300.0, 239.5), (0, 0, 1)), dtype=torch.float64)
        cameras = tuple(replace(camera, intrinsics=scaled, kind="orthographic") for camera in cameras)
    rays = rays_of(rig, cameras)
    assert 150 < len(rays.points) <= 200
    beyond = ((rays.points - CENTRE) * rays.normals).sum(-1)
    assert float((beyond - RADIUS).abs().max()) < 2e-3  # an edge's direction is good to about a tenth of a radian
    assert float((beyond - RADIUS).abs().mean()) < 3e-4
    assert float((rays.along * rays.normals).sum(-1).abs().max()) < 1e-9
    assert torch.allclose(rays.along.norm(dim=-1), torch.ones(len(rays.along), dtype=torch.float64))
    assert (
        float((rays.near(CENTRE.expand_as(rays.points)) - CENTRE).norm(dim=-1).sub(RADIUS).abs().max()) < 6e-4
    )  # a pixel is worth 0.8 mm


def test_a_ray_belongs_to_the_skin_that_faces_across_it(rig: Any) -> None:
    rays = rays_of(rig, rig.cameras)
    outward = torch.nn.functional.normalize(
        torch.randn(4000, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64), dim=-1
    )
    match = rays.match((CENTRE + RADIUS * outward)[None], outward[None], turn=0.012)[0]
    touched = CENTRE + RADIUS * rays.normals
    apart = (CENTRE + RADIUS * outward[match] - touched).norm(dim=-1)
    assert float(apart.max()) < 0.015  # an edge's direction is good to about a tenth of a radian
    assert float(apart.mean()) < 0.005
    single = rays.match((CENTRE + RADIUS * outward)[None].float(), outward[None].float(), turn=0.012)[0]
    assert torch.equal(match, single)


@pytest.mark.parametrize("kinds", [("pinhole",) * 4, ("pinhole", "orthographic", "pinhole", "orthographic")])
def test_match_equals_a_loop_over_views(rig: Any, kinds: tuple[Any, ...]) -> None:
    """With other numbers of rays in each view, and hands that are no hands."""
    scaled = torch.tensor(((1300.0, 0, 319.5), (0, 1300.0, 239.5), (0, 0, 1)), dtype=torch.float64)
    cameras = [
        camera if kind == "pinhole" else replace(camera, intrinsics=scaled, kind=kind)
        for camera, kind in zip(rig.cameras, kinds, strict=True)
    ]
    masks = [ball(camera) for camera in cameras]
    masks[1] = torch.zeros_like(masks[1])
    masks[1][200:204, 300:306] = True
    rays = rims_of(cameras, masks, CENTRE, count=200)
    assert rays is not None
    lengths = [len(view.plane) for view in rays.views]
    assert len(set(lengths)) > 1
    generator = torch.Generator().manual_seed(4)
    vertices = CENTRE + 0.05 * torch.randn(2, 300, 3, generator=generator, dtype=torch.float64)
    vertices[0, 7] = torch.nan
    normals = torch.nn.functional.normalize(torch.randn(2, 300, 3, generator=generator, dtype=torch.float64), dim=-1)
    found = rays.match(vertices, normals, turn=0.01).split(lengths, -1)
    facing = rays.normals.split(lengths)
    for view, own, out in zip(rays.views, found, facing, strict=True):
        in_view = view.scale * view.camera.plane_from_cam(view.camera.cam_from_world(vertices))
        apart = (view.scale * view.plane[:, None] - in_view[:, None]).square().sum(-1)
        apart = apart + (0.01 * (out[:, None] - normals[:, None])).square().sum(-1)
        least = apart.nan_to_num(torch.inf)
        chosen = least.gather(-1, own[..., None]).squeeze(-1)
        assert float((chosen - least.amin(-1)).max()) < 1e-8  # square metres: single precision


def test_thinned_rays_are_some_of_them(rig: Any) -> None:
    rays = rays_of(rig, rig.cameras)
    few = rays.thinned(50)
    assert 40 <= len(few.points) <= 60
    assert [len(view.plane) for view in few.views] == [math.ceil(len(view.plane) / 4) for view in rays.views]
    assert sum(len(view.plane) for view in few.views) == len(few.points)
    first = len(rays.views[0].plane)
    assert torch.equal(few.points[len(few.views[0].plane)], rays.points[first])
    assert torch.equal(few.normals[1], rays.normals[4])


def test_missing_views_and_the_pictures_edges_give_no_rays(rig: Any) -> None:
    mask = ball(rig.cameras[0])
    nothing = torch.zeros_like(mask)
    one = rims_of(rig.cameras, [mask, None, nothing, None], CENTRE)
    assert one is not None
    assert len(one.views) == 1
    assert rims_of(rig.cameras, [nothing, None, None, None], CENTRE) is None
    cut = mask.clone()
    cut[:, :] = False
    cut[:200, :300] = True
    found = rims_of(rig.cameras[:1], [cut], CENTRE)
    assert found is not None
    px = rig.cameras[0].pixels_from_plane(found.views[0].plane)
    assert float(px.min()) > 0.5
    with pytest.raises(ValueError, match="one per camera, 4, got 1"):
        with_rims(rig.target_of_masks([ball(camera) for camera in rig.cameras]), rig.cameras, [mask])


def test_recovers_people_from_noisy_silhouettes(rig: Any) -> None:
    """One pixel of noise, and a covariance that tells how far off the pose is."""
    errors, turns, honesty = [], [], []
    for seed in (2, 3, 5):
        pose, reference, shape = rig.person(seed)
        pose = SPACE.dof(SPACE.free(pose))
        target = rig.with_edges(rig.noisy(rig.masks(pose, reference, shape), seed))
        start = rig.moved(pose, reference, seed, deg=5, mm=8)
        fit = HullFitter(rig.hand, SPACE, shape=shape, constraints=rig.constraints, prior=rig.prior)
        found = fit(target, *start)
        ends = (found.pose, found.root_reference)
        errors.append(rig.error_mm(ends, (pose, reference), shape))
        turns.append(float((rig.flexion_deg(*ends, shape) - rig.flexion_deg(pose, reference, shape)).abs().mean()))
        off = SPACE.free(found.pose) - SPACE.free(pose)
        off[3:6] = vector_from_rotation(found.root_reference @ reference.T)
        honesty.append(float(off @ torch.linalg.solve(found.covariance, off)) / SPACE.size)
        assert bool(found.is_good)
        assert float(found.covered_share) > 0.9
    assert sum(errors) / len(errors) <= 1.5
    assert sum(turns) / len(turns) <= 3
    assert 0.2 < sum(honesty) / len(honesty) < 3


def test_single_steps_from_a_prediction(rig: Any) -> None:
    """What a tracked frame takes: a start a few degrees off, and the belief that it is."""
    pose, reference, shape = rig.person(4)
    pose = SPACE.dof(SPACE.free(pose))
    target = rig.with_edges(rig.masks(pose, reference, shape))
    settings = HullFitSettings(levels=HULL_TRACKING_LEVELS)
    fit = HullFitter(rig.hand, SPACE, settings, shape=shape, constraints=rig.constraints, prior=rig.prior)
    start = rebased(*rig.moved(pose, reference, 1, deg=3, mm=4))
    std = torch.full((SPACE.size,), math.radians(6), dtype=torch.float64)
    std[:3] = 0.006
    found = fit(target, *start, expected=Expectation.from_std(SPACE.free(start[0]), start[1], std))
    assert int(found.iterations) == sum(level.rounds for level in HULL_TRACKING_LEVELS)
    assert found.status in (HullStatus.CONVERGED, HullStatus.STALLED)
    before = rig.error_mm(start, (pose, reference), shape)
    after = rig.error_mm((found.pose, found.root_reference), (pose, reference), shape)
    assert after < 1.5 < before
    batch = fit(target, torch.stack((start[0], start[0])), torch.stack((start[1], start[1])))
    alone = fit(target, *start)
    assert torch.allclose(batch.pose[1], alone.pose, atol=1e-9)
    assert torch.allclose(batch.cost[1], alone.cost)
    broken = start[0].clone()
    broken[8] = torch.nan
    failed = fit(target, broken, start[1])
    assert failed.status == HullStatus.FAILED
    assert not bool(failed.is_good)


def test_verdict(rig: Any) -> None:
    """What is not as the silhouettes show is no good fit: fingers stretched that are bent, and no hand at all."""
    pose, reference, shape = rig.person(4)
    straight, bent = pose.clone(), pose.clone()
    straight[6:], bent[6:] = 0.0, 0.0
    for finger in ("index", "middle"):
        for joint, angle in (("mcp_fe", 75.0), ("pip_fe", 90.0), ("dip_fe", 50.0)):
            bent[DOFS.index(f"{finger}_{joint}")] = math.radians(angle)
    still = HullFitSettings(levels=(HULL_TRACKING_LEVELS[-1],))
    sure = torch.full((SPACE.size,), 1e-5, dtype=torch.float64)

    def judged(masks: list[Tensor], at: Tensor) -> Any:
        fit = HullFitter(rig.hand, SPACE, still, shape=shape, constraints=rig.constraints, prior=rig.prior)
        expected = Expectation.from_std(SPACE.free(at), reference, sure)
        return fit(rig.with_edges(masks), at, reference, expected=expected)

    right, wrong = (judged(rig.masks(bent, reference, shape), at) for at in (bent, straight))
    assert bool(right.is_good)
    assert not bool(wrong.is_good)
    assert float(wrong.covered_share) < 0.88 < 0.95 < float(right.covered_share)
    assert not bool(judged([ball(camera) for camera in rig.cameras], bent).is_good)
