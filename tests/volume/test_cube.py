"""The common viewing volume against sampled points, and the messages of rigs that see nothing together."""

from dataclasses import replace
from typing import Any

import pytest
import torch

from torchhand.volume.carving import Carver
from torchhand.volume.cube import RootCube, common_volume, root_cube


def seen_by(camera: Any, points: torch.Tensor, nearest: float, farthest: float) -> torch.Tensor:
    column, row = camera.project(points).unbind(-1)
    depth = camera.cam_from_world(points)[:, 2]
    inside = (column > -0.5) & (row > -0.5) & (column < camera.width - 0.5) & (row < camera.height - 0.5)
    return inside & (depth > nearest) & (depth < farthest)


@pytest.mark.parametrize("kinds", [("pinhole",) * 3, ("pinhole", "orthographic", "pinhole")])
@pytest.mark.parametrize("lens", [0, 5])
def test_what_all_cameras_see_is_within_the_corners(kinds: tuple[str, ...], lens: int, rigs: Any) -> None:
    places = ((0.4, 0.1, 0.0), (0.0, 0.5, 0.1), (-0.1, 0.0, -0.45))
    cameras = [
        rigs.looking(place, kind=kind, lens=lens if kind == "pinhole" else 0)
        for place, kind in zip(places, kinds, strict=True)
    ]
    corners = common_volume(cameras, nearest=0.1, farthest=0.8)
    generator = torch.Generator().manual_seed(0)
    points = 1.6 * torch.rand(100_000, 3, generator=generator, dtype=torch.float64) - 0.8
    common = points[torch.stack([seen_by(camera, points, 0.1, 0.8) for camera in cameras]).all(0)]
    assert len(common) > 500
    low, high = corners.amin(0), corners.amax(0)
    assert bool(((common >= low) & (common <= high)).all())
    if not lens:  # the volume is no larger: its box is filled up to where no sample fell
        assert float((common.amin(0) - low).max()) < 0.06
        assert float((high - common.amax(0)).max()) < 0.06
        shrunk = corners.mean(0) + 0.999 * (corners - corners.mean(0))
        assert all(bool(seen_by(camera, shrunk, 0.1, 0.8).all()) for camera in cameras)
    cube = root_cube(cameras, nearest=0.1, farthest=0.8)
    centre = torch.tensor(cube.centre, dtype=torch.float64)
    assert bool(((common - centre).abs() <= 0.5 * cube.side).all())
    assert cube.side == pytest.approx(float((high - low).max()))


def test_closed_form_of_one_camera(rigs: Any) -> None:
    camera = replace(
        rigs.looking((0.0, 0.0, -1.0)), rotation=torch.eye(3).double(), translation=torch.zeros(3).double()
    )
    corners = common_volume([camera], nearest=0.5, farthest=1.0)
    assert len(corners.unique(dim=0)) == 8
    ends = torch.tensor([(x, y) for x in (-0.5, 159.5) for y in (-0.5, 119.5)], dtype=torch.float64)
    plane = camera.plane_from_pixels(ends)
    expected = torch.cat([depth * torch.cat((plane, torch.ones(4, 1).double()), -1) for depth in (0.5, 1.0)])
    assert float(torch.cdist(expected, corners).amin(-1).max()) < 1e-12


def test_carver_takes_the_cube_from_the_cameras(rigs: Any) -> None:
    cameras = [rigs.looking((0.4, 0.0, 0.0)), rigs.looking((0.0, 0.4, 0.0))]
    assert Carver(cameras).root == root_cube(cameras)


def test_says_which_cameras_see_nothing_together(rigs: Any) -> None:
    front = rigs.looking((0.0, 0.0, -0.5), name="front")
    side = rigs.looking((0.5, 0.0, 0.0), name="side")
    away = rigs.looking((0.0, 0.6, 0.0), at=(0.0, 2.0, 0.0), name="away")
    with pytest.raises(ValueError, match=r"seen by all of front, side, away .*'front' and 'away' share none"):
        common_volume([front, side, away])
    millimetres = replace(side, translation=1000 * side.translation)
    with pytest.raises(ValueError, match=r"'front' and 'side' share none.*check the unit of t"):
        Carver([front, millimetres])
    with pytest.raises(ValueError, match="at least one, got none"):
        common_volume([])
    with pytest.raises(ValueError, match=r"0 < nearest < farthest, got 1\.0 and 0\.5"):
        common_volume([front], nearest=1.0, farthest=0.5)


def test_three_that_share_in_pairs_only(rigs: Any) -> None:
    """Narrow beams around a triangle."""
    places = [(1.0, 0.0, 0.0), (-0.5, 0.866, 0.0), (-0.5, -0.866, 0.0)]
    beams = [rigs.looking(places[k], at=places[(k + 1) % 3], focal=2000.0, name=f"beam{k}") for k in range(3)]
    with pytest.raises(ValueError, match="every two of them share some"):
        common_volume(beams, nearest=0.001, farthest=3.0)


@pytest.mark.parametrize(("side", "centre"), [(0.0, (0.0, 0.0, 0.0)), (1.0, (0.0, float("nan"), 0.0))])
def test_a_cube_needs_a_place_and_a_size(side: float, centre: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match="expected"):
        RootCube(centre=centre, side=side)
