"""Crops of recordings: points and cameras go with the pixels, left hands are right ones in the mirror."""

import numpy as np
import pytest
import torch

from tests.learn.pictures.conftest import Recording
from torchhand.errors import InputError
from torchhand.geometry import assumed_camera
from torchhand.learn.pictures import recorded_crops, step_generator
from torchhand.learn.pictures.cutting import cut, moved_intrinsics, moved_points, window_about


def test_points_go_with_the_pixels_also_beyond_the_edge() -> None:
    """The middle of mass of a dot in the picture, and that in its crop."""
    y, x = np.mgrid[:60, :80]
    for centre, window in (((40.3, 21.8), (10, 3, 55)), ((15.0, 40.0), (-9, 5, 64))):
        dot = np.exp(-((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / 18)
        crop = cut((255 * dot).astype(np.uint8), window).astype(float)
        rows, columns = np.mgrid[:48, :48]
        found = torch.tensor([(columns * crop).sum(), (rows * crop).sum()]) / crop.sum()
        wanted = moved_points(torch.tensor(centre, dtype=torch.float64), window)
        assert float((found - wanted).norm()) < 0.35  # the dot's foot is cut, and grey levels are rounded


def test_the_camera_of_a_crop_projects_where_the_points_are_moved_to() -> None:
    camera = assumed_camera(640, 480)
    points = torch.tensor(((0.05, 0.02, 0.5), (-0.03, 0.06, 0.45)), dtype=torch.float64)
    pixels, window = camera.project(points), (300, 200, 170)
    rays = points / points[:, 2:]
    torch.testing.assert_close(
        (rays @ moved_intrinsics(camera.intrinsics, window).mT)[:, :2], moved_points(pixels, window), atol=1e-9, rtol=0
    )


def test_the_hand_fills_its_crop_as_wanted() -> None:
    points = torch.tensor(((10.0, 20.0), (70.0, 50.0))).repeat(11, 1)[:21]
    moved = moved_points(points, window_about(points, share=0.75))
    assert float(moved.amax(0)[0] - moved.amin(0)[0]) == pytest.approx(0.75 * 48, abs=0.5)
    torch.testing.assert_close(0.5 * (moved.amax(0) + moved.amin(0)), torch.full((2,), 23.5), atol=0.5, rtol=0)


def test_frames_with_a_hand_are_cut_and_their_silhouettes_found(recording: Recording) -> None:
    crops = recorded_crops(recording.pictures, recording.points, range(8))
    assert crops.frame.tolist() == [0, 1, 2, 4, 5, 6, 7]
    assert crops.known.flatten(1).any(1).all()
    inside = crops.points_px.round().long().clamp(0, 47)
    for mask, points in zip(crops.mask, inside, strict=True):
        assert float(mask[points[:, 1], points[:, 0]].mean()) > 0.7  # joints lie in the skin, most of them
    many = recorded_crops(recording.pictures, recording.points, range(2, 5), views=3, generator=step_generator(0, 1))
    assert many.frame.tolist() == [2, 2, 2, 4, 4, 4]
    assert not torch.equal(many.image[0], many.image[1])


def test_left_hands_are_seen_in_the_mirror(recording: Recording) -> None:
    own = recorded_crops(recording.pictures, recording.points, range(8))
    other = recorded_crops(recording.mirrored_pictures, recording.mirrored_points, range(8))
    torch.testing.assert_close(other.points_px, own.points_px, atol=1.0, rtol=0)  # windows are of whole pixels
    torch.testing.assert_close(other.intrinsics[:, 0, 0], own.intrinsics[:, 0, 0])
    rays = [
        (crops.points_px[..., 0] - crops.intrinsics[:, None, 0, 2]) / crops.intrinsics[:, None, 0, 0]
        for crops in (own, other)
    ]
    torch.testing.assert_close(rays[0], rays[1], atol=1e-4, rtol=0)
    assert float((own.mask - other.mask).abs().mean()) < 0.05


def test_recordings_without_hands_are_told(recording: Recording) -> None:
    with pytest.raises(InputError, match="expected a hand in some of the frames 3 to 3; none"):
        recorded_crops(recording.pictures, recording.points, range(3, 4))
