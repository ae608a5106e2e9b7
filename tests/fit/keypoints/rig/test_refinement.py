"""Cameras that are roughly known, refined by the points of a hand."""

import math
from dataclasses import replace

import pytest
import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.fit.keypoints.rig import refined_cameras
from torchhand.geometry import Camera, assumed_camera, rotation_from_vector, vector_from_rotation

NOISE_PX = 1.0


def rig(count: int) -> list[Camera]:
    """Cameras around a place 0.6 m before the first."""
    middle = torch.tensor((0.0, 0.0, 0.6), dtype=torch.float64)
    turns = [rotation_from_vector(torch.tensor((0.2 * i, 0.5 * i, 0.1), dtype=torch.float64)) for i in range(count)]
    return [replace(assumed_camera(640, 480), rotation=turn, translation=middle - turn @ middle) for turn in turns]


def roughly(cameras: list[Camera], turn_deg: float, shift_m: float) -> list[Camera]:
    """All but the first turned and shifted, in the same mean distance from the first."""
    generator = torch.Generator().manual_seed(2)
    found = [cameras[0]]
    for camera in cameras[1:]:
        axis, shift = torch.randn(2, 3, generator=generator, dtype=torch.float64)
        turn = rotation_from_vector(math.radians(turn_deg) * axis / axis.norm())
        found.append(
            replace(
                camera,
                rotation=turn @ camera.rotation,
                translation=turn @ camera.translation + shift_m * shift / shift.norm(),
            )
        )
    scale = spread(cameras) / spread(found)
    origin = centre(cameras[0])
    return [
        replace(camera, translation=-camera.rotation @ (origin + scale * (centre(camera) - origin))) for camera in found
    ]


def centre(camera: Camera) -> Tensor:
    return -camera.rotation.mT @ camera.translation


def spread(cameras: list[Camera]) -> Tensor:
    return torch.stack([(centre(one) - centre(cameras[0])).square().sum() for one in cameras[1:]]).mean().sqrt()


def moving(frames: int, reach: float) -> Float[Tensor, "frames 21 3"]:
    """A cloud as large as a hand on its way through the rig."""
    generator = torch.Generator().manual_seed(3)
    cloud = 0.15 * (torch.rand(21, 3, generator=generator, dtype=torch.float64) - 0.5)
    time = torch.linspace(0, 2 * math.pi, frames, dtype=torch.float64)
    way = torch.stack((time.sin(), (2 * time).cos(), (1.5 * time).sin()), -1)
    return cloud + reach * way[:, None] + torch.tensor((0.0, 0.0, 0.6), dtype=torch.float64)


def seen(cameras: list[Camera], points: Tensor) -> list[Tensor]:
    generator = torch.Generator().manual_seed(4)
    return [
        camera.project(points) + NOISE_PX * torch.randn(*points.shape[:2], 2, generator=generator, dtype=torch.float64)
        for camera in cameras
    ]


@pytest.mark.parametrize("count", [2, 3])
def test_rough_cameras_are_found_with_honest_errors(count: int) -> None:
    cameras, points = rig(count), moving(36, 0.08)
    rough, pixels = roughly(cameras, 2.0, 0.02), seen(cameras, points)
    if count > 2:  # two views cannot tell which of them is right
        pixels[1][5:8] += 60.0  # another hand
    pixels[0][10, :] = torch.nan
    std = [torch.full((len(points),), 2.0, dtype=torch.float64)] * count  # twice what it is
    found = refined_cameras(rough, pixels, std)
    assert bool(found.is_determined.all())
    for camera, true, covariance in zip(found.cameras[1:], cameras[1:], found.covariance, strict=True):
        turn = vector_from_rotation(camera.rotation @ true.rotation.mT)
        assert float(turn.norm().rad2deg()) < (0.3 if count > 2 else 0.8)
        assert float((centre(camera) - centre(true)).norm()) < 0.004
        std_deg = covariance.diagonal()[:3].sqrt().rad2deg()
        assert bool((turn.rad2deg().abs() < 4 * std_deg).all())
        assert float(std_deg.max()) < 0.5
    torch.testing.assert_close(spread(list(found.cameras)), spread(rough), rtol=1e-3, atol=0)


def test_a_hand_that_is_seen_too_briefly_determines_nothing() -> None:
    cameras, points = rig(3), moving(36, 0.08)[:20]
    std = [torch.full((len(points),), 1.0, dtype=torch.float64)] * 3
    found = refined_cameras(roughly(cameras, 1.0, 0.01), seen(cameras, points), std)
    assert not bool(found.is_determined.any())


@pytest.mark.slow
def test_points_of_two_cameras_in_one_small_place_do_not_determine_them() -> None:
    cameras = rig(2)
    points = 0.02 * moving(36, 0.0) + 0.98 * torch.tensor((0.0, 0.0, 0.6), dtype=torch.float64)
    std = [torch.full((len(points),), 1.0, dtype=torch.float64)] * 2
    found = refined_cameras(roughly(cameras, 1.0, 0.01), seen(cameras, points), std)
    assert not bool(found.is_determined.any())


def test_what_cannot_be_refined_is_refused() -> None:
    cameras, points = rig(2), moving(4, 0.05)
    std = [torch.ones(4, dtype=torch.float64)] * 2
    with pytest.raises(ValueError, match="expected two or more, got 1"):
        refined_cameras(cameras[:1], seen(cameras[:1], points), std[:1])
    with pytest.raises(ValueError, match="one place"):
        refined_cameras([cameras[0], cameras[0]], seen([cameras[0]] * 2, points), std)
