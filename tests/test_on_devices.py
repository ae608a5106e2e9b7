"""What computes gives on a device what it gives on the processor: model, prior, hulls, simulator, proposals, keypoints.

The observations and priors of fits: `tests/fit/test_host_reads.py`.
"""

from typing import Any

import pytest
import torch
from torch import Tensor

from tests.device_guard import on_device
from tests.fit.hull.conftest import Rig, make_rig
from tests.studio import StagedHand, Studio
from torchhand.files import load_hand_model, load_proposal_network
from torchhand.fit.hull import target_of, with_rays
from torchhand.fit.keypoints import KeypointFitSettings, SeenKeypoints, fit_keypoints
from torchhand.geometry import assumed_camera
from torchhand.hand import HandModel, posture, skin_jacobian
from torchhand.image import distance_map
from torchhand.propose import Silhouette, propose_hands
from torchhand.simulate import Motion, SceneSettings, render_sequence
from torchhand.view import MeshContours, rasterize
from torchhand.volume import Carver, CarvingSettings, RootCube, hull_field

MODEL = load_hand_model()
CPU = torch.device("cpu")


def model_on(device: torch.device) -> HandModel:
    return MODEL if device == CPU else MODEL.to(device=device)


def same(found: Any, expected: Any, *, atol: float = 1e-9) -> None:
    torch.testing.assert_close(on_device(found, CPU), expected, rtol=1e-9, atol=atol, equal_nan=True)


@pytest.fixture(scope="module")
def placed() -> StagedHand:
    studio = Studio()
    return studio.placed(posed="open", camera=studio.camera(160, 128))


@pytest.fixture(scope="module")
def rig() -> Rig:
    return make_rig()


def test_hands_and_their_gradients(device: torch.device) -> None:
    def worked(there: torch.device) -> tuple[Tensor, ...]:
        pose = posture("point", dtype=torch.float64).to(there).requires_grad_()
        hand = model_on(there).hand(dtype=torch.float64)
        state = hand(pose)
        (state.vertices.square().sum() + state.keypoints.sum()).backward()
        assert pose.grad is not None
        points, slopes = skin_jacobian(hand, pose.detach()[None], hand.faces[:40])
        return state.vertices.detach(), pose.grad, points, slopes

    for found, expected in zip(worked(device), worked(CPU), strict=True):
        assert found.device.type == device.type
        same(found, expected)


@pytest.mark.slow
def test_the_prior(device: torch.device) -> None:
    def worked(there: torch.device) -> tuple[Tensor, ...]:
        prior = model_on(there).prior(dtype=torch.float64)
        pose, shape = prior.sample(2, torch.Generator().manual_seed(0))
        assert pose.device.type == there.type
        pose.requires_grad_()
        energy = prior.energy(pose, shape)
        energy.sum().backward()
        assert pose.grad is not None
        return pose.detach(), shape, energy.detach(), pose.grad

    for found, expected in zip(worked(device), worked(CPU), strict=True):
        same(found, expected)


def test_pictures_of_meshes_and_distance_maps(device: torch.device, placed: StagedHand) -> None:
    def worked(there: torch.device) -> tuple[Tensor, ...]:
        hand = model_on(there).hand(dtype=torch.float64)
        pose, reference = placed.pose.to(there), placed.root_reference.to(there)
        camera = placed.camera.to(device=there)
        vertices = hand(pose, root_reference=reference).vertices
        seen = rasterize(vertices, hand.faces, camera, is_closed=True)
        contours = MeshContours(hand, camera, max_points=80)
        assert contours.camera.rotation.device.type == there.type
        return seen.depth, seen.part, distance_map(seen.part >= 0)

    found, expected = worked(device), worked(CPU)
    same(found[0], expected[0])
    assert torch.equal(found[1].cpu(), expected[1])
    same(found[2], expected[2], atol=1e-3)  # that of the processor is good to 1e-3 px


def test_hulls(device: torch.device, rig: Rig) -> None:
    pose, shape = rig.person(3)
    masks = rig.masks(pose, shape)

    def worked(there: torch.device) -> tuple[Tensor, ...]:
        cameras, seen = on_device((rig.cameras, tuple(masks)), there)
        octree = Carver(cameras, RootCube(centre=(0.0, 0.0, 0.0), side=0.512), CarvingSettings(level=6)).carve(
            list(seen)
        )
        target = with_rays(target_of(hull_field(octree, surface="middle")), cameras, list(seen), count=120)
        assert target.rays is not None
        return target.points, target.normals, target.depth, target.rays.points

    for found, expected in zip(worked(device), worked(CPU), strict=True):
        assert found.device.type == device.type
        same(found, expected, atol=1e-4)  # distances in float32


def test_simulated_pictures(device: torch.device, placed: StagedHand) -> None:
    def worked(there: torch.device) -> tuple[Tensor, ...]:
        motion = Motion(
            name="still", poses=placed.pose[None].to(there), root_reference=placed.root_reference.to(there), fps=30.0
        )
        scene = SceneSettings(supersampling=2, blur_px=0.8, noise=3.0, forearm=True)
        kinematics = model_on(there).kinematics(dtype=torch.float64)
        camera, generator = placed.camera.to(device=there), torch.Generator().manual_seed(0)
        frame = next(iter(render_sequence(kinematics, motion, camera, scene, generator)))
        return frame.image, frame.mask, frame.keypoints_px

    found, expected = worked(device), worked(CPU)
    assert int((found[0].cpu().int() - expected[0].int()).abs().max()) <= 1  # of rounding to grey levels
    assert torch.equal(found[1].cpu(), expected[1])
    same(found[2], expected[2])


def test_proposed_hands(device: torch.device, placed: StagedHand) -> None:
    image = placed.picture(SceneSettings(supersampling=1))

    def worked(there: torch.device) -> tuple[Tensor, ...]:
        network = load_proposal_network(None).to(there)
        camera = placed.camera.to(device=there)
        silhouette = Silhouette(mask=placed.mask.to(there), camera=camera, image=image.to(there))
        found = propose_hands(network, [silhouette], model_on(there).kinematics("left", dtype=torch.float64))
        return found.pose.dofs, found.pose.reference, found.weight

    for found, expected in zip(worked(device), worked(CPU), strict=True):
        assert found.device.type == device.type
        same(found, expected, atol=1e-3)  # the network is one of float32


@pytest.mark.slow
def test_fits_to_keypoints(device: torch.device) -> None:
    camera = assumed_camera(320, 240)
    pose, _ = MODEL.prior(dtype=torch.float64).sample(1, torch.Generator().manual_seed(1))
    pose[:, :3] = torch.tensor((0.0, 0.0, 0.5), dtype=torch.float64)
    points = MODEL.kinematics(dtype=torch.float64)(pose).keypoints

    def worked(there: torch.device) -> tuple[Tensor, ...]:
        seen = SeenKeypoints(
            camera=camera.to(device=there), points_px=camera.project(points).to(there), points=points.to(there)
        )
        settings = KeypointFitSettings(starts=1)
        found = fit_keypoints(model_on(there).kinematics(dtype=torch.float64), seen, settings=settings)
        return found.keypoints, found.is_fitted

    found, expected = worked(device), worked(CPU)
    assert bool(expected[1].all())
    assert torch.equal(found[1].cpu(), expected[1])
    same(
        found[0], expected[0], atol=1e-4
    )  # metres: a step that promises less than a thousandth of the cost is not taken
