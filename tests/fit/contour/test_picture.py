"""What is kept of a picture: maps from coarse to fine, valleys where fingers touch, nothing where there is nothing."""

from typing import Any

import pytest
import torch

from torchhand.fit import Stage
from torchhand.fit.contour.picture import picture_contours
from torchhand.fit.contour.settings import SEARCH, ContourSettings


def test_maps_from_coarse_to_fine(studio: Any) -> None:
    """Small hands get no map on which a finger would vanish."""
    mask = studio.placed(camera=studio.camera(400, 320)).mask
    settings = ContourSettings()
    found = picture_contours(mask, SEARCH, settings)
    assert [found.field(stage.pitch_px).pitch_px for stage in SEARCH] == [3.0, 2.0, 1.0]
    assert all(field.channels == settings.directions for field in found.fields.values())
    assert len(found.boundary.points_px) == settings.boundary_points
    assert found.valleys is None
    small = picture_contours(studio.placed().mask, SEARCH, settings)
    assert [small.field(stage.pitch_px).pitch_px for stage in SEARCH] == [1.0, 1.0, 1.0]
    assert not small.is_empty


def test_a_pitch_that_the_picture_was_not_made_for(studio: Any) -> None:
    coarse = picture_contours(studio.placed(camera=studio.camera(400, 320)).mask, SEARCH[:1])
    assert coarse.field(8) is coarse.field(4)
    with pytest.raises(ValueError, match="pitch_px: expected one of the picture's, 3 or more, got 1"):
        coarse.field(1)


def test_valleys_are_the_dark_lines_within_the_hand(studio: Any) -> None:
    placed = studio.placed(camera=studio.camera(400, 320))
    image, points = torch.full((320, 400, 3), 40, dtype=torch.uint8), placed.keypoints_px
    image[placed.mask] = torch.tensor((200, 150, 120), dtype=torch.uint8)
    x, y = (0.5 * (points[0] + points[9])).round().long().tolist()  # middle of the palm
    image[y - 20 : y + 20, x] = 60
    found = picture_contours(placed.mask, SEARCH, image=image)
    assert found.valleys is not None
    probe = torch.tensor([[x, y], [x + 9.0, y]], dtype=torch.float64)
    distance, _ = found.valleys.sample(probe)
    torch.testing.assert_close(distance, torch.tensor((0.0, 9.0)).double(), atol=0.6, rtol=0)
    assert picture_contours(placed.mask, SEARCH, ContourSettings(valley_weight=0.0), image=image).valleys is None
    grey = picture_contours(placed.mask, SEARCH, image=image.float().mean(-1)).valleys
    assert grey is not None
    torch.testing.assert_close(grey.sample(probe)[0], distance, atol=0.6, rtol=0)


def test_an_empty_silhouette_has_no_contour(studio: Any) -> None:
    assert picture_contours(torch.zeros_like(studio.placed().mask), SEARCH).is_empty


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("directions", 0),
        ("boundary_points", 3),
        ("contour_std_px", 0.0),
        ("probe_distance_m", -1.0),
        ("coverage_weight", -1.0),
        ("valley_weight", float("inf")),
    ],
)
def test_settings_say_what_is_wrong(field: str, value: Any) -> None:
    with pytest.raises(ValueError, match=f"contour.{field}: expected"):
        ContourSettings(**{field: value})


@pytest.mark.parametrize(
    ("field", "value"),
    [("pitch_px", 0), ("rounds", 0), ("iterations", 0), ("gross_m", 0.0)],
)
def test_stages_say_what_is_wrong(field: str, value: Any) -> None:
    with pytest.raises(ValueError, match=f"stage.{field}: expected"):
        Stage(**{"gross_m": 0.01, field: value})
