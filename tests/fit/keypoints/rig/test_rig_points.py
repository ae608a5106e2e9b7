"""Points of several cameras: triangulated, views of another hand left out, cameras that are late."""

from dataclasses import replace

import pytest
import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.fit.keypoints.rig import ViewLag, triangulated
from torchhand.geometry import Camera, assumed_camera, rotation_from_vector

STD = torch.full((6,), 3.0, dtype=torch.float64)


def _rig(count: int) -> list[Camera]:
    middle = torch.tensor((0.0, 0.0, 0.6), dtype=torch.float64)
    turns = [rotation_from_vector(torch.tensor((0.1 * i, 0.5 * i, 0.0), dtype=torch.float64)) for i in range(count)]
    return [replace(assumed_camera(640, 480), rotation=turn, translation=middle - turn @ middle) for turn in turns]


def _points() -> Float[Tensor, "6 21 3"]:
    generator = torch.Generator().manual_seed(3)
    about = 0.1 * (torch.rand(6, 21, 3, generator=generator, dtype=torch.float64) - 0.5)
    return about + torch.tensor((0.0, 0.0, 0.6), dtype=torch.float64)


def test_exact_points_come_back_from_any_two_views_and_missing_ones_stay_missing() -> None:
    points, rig = _points(), _rig(3)
    seen = [camera.project(points) for camera in rig]
    seen[0][:, 4] = torch.nan
    for view in seen[1:]:
        view[2, 7] = torch.nan
    found = triangulated(rig, seen, [STD] * 3)
    is_known = found.points.isfinite().all(-1)
    assert not bool(is_known[2, 7])
    assert int((~is_known).sum()) == 1
    torch.testing.assert_close(found.points[is_known], points[is_known], rtol=0, atol=1e-8)
    assert bool(found.agrees.all())


def test_a_view_of_another_hand_and_a_wrong_point_do_not_count() -> None:
    points, rig = _points(), _rig(4)
    seen = [camera.project(points) for camera in rig]
    seen[1][3] = rig[1].project(points[3] + torch.tensor((0.15, 0.05, 0.0), dtype=torch.float64))
    seen[2][0, 8] += 200.0
    found = triangulated(rig, seen, [STD] * 4)
    expected = torch.ones(6, 4, dtype=torch.bool)
    expected[3, 1] = False
    assert torch.equal(found.agrees, expected)
    torch.testing.assert_close(found.points, points, rtol=0, atol=1e-3)


def test_two_views_of_different_hands_agree_in_nothing() -> None:
    points, rig = _points(), _rig(2)
    other = points + torch.tensor((0.1, 0.12, 0.05), dtype=torch.float64)
    found = triangulated(rig, [rig[0].project(points), rig[1].project(other)], [STD] * 2)
    assert not bool(found.agrees.any())
    assert bool(found.points.isnan().all())


def test_a_lag_shifts_polynomials_exactly_and_knows_its_slope() -> None:
    """Catmull and Rom's cubic is exact for parabolas; frames without points lend their neighbours'."""
    time = torch.arange(20, dtype=torch.float64)
    track = torch.stack((3 * time, 0.5 * time**2 - time), -1)[:, None].repeat(1, 21, 1)
    for value in (0.0, 0.4, -1.3, 2.9):
        lag = ViewLag.of(track, std=1.0, place=0).at(torch.tensor((value,), dtype=torch.float64))
        points, slope = lag.rows(torch.arange(5, 15)).points_px()
        late = time[5:15] + value
        torch.testing.assert_close(points[:, 3], torch.stack((3 * late, 0.5 * late**2 - late), -1), rtol=0, atol=1e-9)
        torch.testing.assert_close(
            slope[:, 3], torch.stack((torch.full_like(late, 3.0), late - 1), -1), rtol=0, atol=1e-9
        )
    holes = track.clone()
    holes[9] = torch.nan
    points, _ = ViewLag.of(holes, std=1.0, place=0).points_px()
    assert points.isnan().flatten(1).any(1).nonzero().flatten().tolist() == [9]


def test_noise_alone_makes_no_camera_late() -> None:
    """Between two frames the noise of both averages out: points there fit better, but not because they were late."""
    generator = torch.Generator().manual_seed(5)
    noise = torch.randn(400, 21, 2, generator=generator, dtype=torch.float64)
    lag = ViewLag.of(noise, std=1.0, place=0)
    inner = torch.arange(10, 390)
    costs, slopes = [], []
    for value in (0.0, 0.25, 0.5, 0.75):
        at = lag.at(torch.tensor((value,), dtype=torch.float64)).rows(inner)
        size, growth = at.noise()
        costs.append(float((at.points_px()[0] / size).square().mean()))
        step = 1e-6
        beyond = lag.at(torch.tensor((value + step,), dtype=torch.float64)).noise()[0]
        slopes.append((float(growth), float((beyond - size) / step)))
    assert costs == pytest.approx([1.0] * 4, rel=0.03)
    for found, expected in slopes:
        assert found == pytest.approx(expected, abs=1e-4)
