"""Rays through the edges of silhouettes, and the fit to them."""

import math
from dataclasses import replace
from typing import Any

import pytest
import torch

from tests.fit.hull.conftest import CENTRE, RADIUS, ball
from torchhand.fit import GaussianPrior, SolveStatus
from torchhand.fit.hull.fitter import HullEvidence, HullFitter
from torchhand.fit.hull.rays import SilhouetteRays, silhouette_rays
from torchhand.fit.hull.settings import TRACKING
from torchhand.fit.hull.target import with_rays
from torchhand.geometry import Camera
from torchhand.hand import HandPose, named_pose_space

SPACE = named_pose_space("dof28")


def rays_of(rig: Any, cameras: tuple[Camera, ...], count: int = 200) -> SilhouetteRays:
    found = silhouette_rays(cameras, [ball(camera) for camera in cameras], CENTRE, count=count)
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
    assert float((rays.directions * rays.normals).sum(-1).abs().max()) < 1e-9
    assert torch.allclose(rays.directions.norm(dim=-1), torch.ones(len(rays.directions), dtype=torch.float64))
    assert (
        float((rays.nearest_to(CENTRE.expand_as(rays.points)) - CENTRE).norm(dim=-1).sub(RADIUS).abs().max()) < 6e-4
    )  # a pixel is worth 0.8 mm


def test_a_ray_belongs_to_the_skin_that_faces_across_it(rig: Any) -> None:
    rays = rays_of(rig, rig.cameras)
    outward = torch.nn.functional.normalize(
        torch.randn(4000, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64), dim=-1
    )
    match = rays.match((CENTRE + RADIUS * outward)[None], outward[None], turn=0.012)[0]
    touched = CENTRE + RADIUS * rays.normals
    distance = (CENTRE + RADIUS * outward[match] - touched).norm(dim=-1)
    assert float(distance.max()) < 0.015  # an edge's direction is good to about a tenth of a radian
    assert float(distance.mean()) < 0.005
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
    rays = silhouette_rays(cameras, masks, CENTRE, count=200)
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
        squared = (view.scale * view.plane[:, None] - in_view[:, None]).square().sum(-1)
        squared = squared + (0.01 * (out[:, None] - normals[:, None])).square().sum(-1)
        squared = squared.nan_to_num(torch.inf)
        chosen = squared.gather(-1, own[..., None]).squeeze(-1)
        assert float((chosen - squared.amin(-1)).max()) < 1e-8  # square metres: single precision


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
    one = silhouette_rays(rig.cameras, [mask, None, nothing, None], CENTRE)
    assert one is not None
    assert len(one.views) == 1
    assert silhouette_rays(rig.cameras, [nothing, None, None, None], CENTRE) is None
    cut = mask.clone()
    cut[:, :] = False
    cut[:200, :300] = True
    found = silhouette_rays(rig.cameras[:1], [cut], CENTRE)
    assert found is not None
    px = rig.cameras[0].pixels_from_plane(found.views[0].plane)
    assert float(px.min()) > 0.5
    with pytest.raises(ValueError, match="one per camera, 4, got 1"):
        with_rays(rig.target_of_masks([ball(camera) for camera in rig.cameras]), rig.cameras, [mask])


def test_recovers_people_from_noisy_silhouettes(rig: Any) -> None:
    """One pixel of noise, and a covariance that tells how far off the pose is."""
    errors, turns, honesty = [], [], []
    for seed in (2, 3, 5):
        pose, shape = rig.person(seed)
        pose = HandPose(dofs=SPACE.dof(SPACE.free(pose.dofs)), reference=pose.reference)
        target = rig.with_edges(rig.noisy(rig.masks(pose, shape), seed))
        fit = HullFitter(hand=rig.hand, space=SPACE, shape=shape, joints=rig.joints)
        found = fit(target, rig.moved(pose, seed, deg=5, mm=8))
        errors.append(rig.error_mm(found.pose, pose, shape))
        turns.append(float((rig.flexion_deg(found.pose, shape) - rig.flexion_deg(pose, shape)).abs().mean()))
        off = SPACE.free(pose.step_to(found.pose))
        honesty.append(float(off @ torch.linalg.solve(found.covariance, off)) / SPACE.size)
        evidence = HullEvidence.of(found)
        assert bool(evidence.is_good)
        assert float(evidence.covered) > 0.9
    assert sum(errors) / len(errors) <= 1.5
    assert sum(turns) / len(turns) <= 3
    assert 0.2 < sum(honesty) / len(honesty) < 3


def test_single_steps_from_a_prediction(rig: Any) -> None:
    """What a tracked frame takes: a start a few degrees off, and the belief that it is."""
    pose, shape = rig.person(4)
    pose = HandPose(dofs=SPACE.dof(SPACE.free(pose.dofs)), reference=pose.reference)
    target = rig.with_edges(rig.masks(pose, shape))
    fit = HullFitter(hand=rig.hand, space=SPACE, shape=shape, schedule=TRACKING, joints=rig.joints)
    start = rig.moved(pose, 1, deg=3, mm=4).normalized()
    std = torch.full((SPACE.size,), math.radians(6), dtype=torch.float64)
    std[:3] = 0.006
    found = fit(target, start, GaussianPrior.of_std(start, std, SPACE))
    assert len(TRACKING) <= int(found.iterations) <= sum(stage.rounds for stage in TRACKING)
    assert found.status in (SolveStatus.CONVERGED, SolveStatus.STALLED)
    assert rig.error_mm(found.pose, pose, shape) < 1.5 < rig.error_mm(start, pose, shape)
    batch, alone = fit(target, HandPose.stack([start, start])), fit(target, start)
    assert torch.allclose(batch.pose.dofs[1], alone.pose.dofs, atol=1e-9)
    assert torch.allclose(batch.cost[1], alone.cost)
    broken = start.dofs.clone()
    broken[8] = torch.nan
    failed = fit(target, HandPose(dofs=broken, reference=start.reference))
    assert failed.status == SolveStatus.FAILED
    assert not bool(HullEvidence.of(failed).is_good)
