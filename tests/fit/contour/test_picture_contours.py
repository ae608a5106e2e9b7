"""What registration keeps of a picture: levels, valleys where fingers touch, nothing where there is nothing."""

from typing import Any

import pytest
import torch

from torchhand.fit.contour.picture_contours import picture_contours
from torchhand.fit.contour.settings import RegistrationLevel, RegistrationSettings


def test_levels_from_coarse_to_fine(studio: Any) -> None:
    """Small hands get no map on which a finger would vanish."""
    mask = studio.placed(camera=studio.camera(400, 320)).mask
    settings = RegistrationSettings()
    found = picture_contours(mask, settings)
    assert [field.pitch_px for field in found.fields] == [3.0, 2.0, 1.0]
    assert all(field.channels == settings.directions for field in found.fields)
    assert len(found.boundary.points_px) == settings.boundary_points
    assert found.valleys is None
    small = picture_contours(studio.placed().mask, settings)
    assert [field.pitch_px for field in small.fields] == [1.0, 1.0, 1.0]
    assert not small.is_empty


def test_valleys_are_the_dark_lines_within_the_hand(studio: Any) -> None:
    placed = studio.placed(camera=studio.camera(400, 320))
    image, points = torch.full((320, 400, 3), 40, dtype=torch.uint8), placed.keypoints_px
    image[placed.mask] = torch.tensor((200, 150, 120), dtype=torch.uint8)
    x, y = (0.5 * (points[0] + points[9])).round().long().tolist()  # middle of the palm
    image[y - 20 : y + 20, x] = 60
    found = picture_contours(placed.mask, image=image)
    assert found.valleys is not None
    probe = torch.tensor([[x, y], [x + 9.0, y]], dtype=torch.float64)
    distance, _ = found.valleys.sample(probe)
    torch.testing.assert_close(distance, torch.tensor((0.0, 9.0)).double(), atol=0.6, rtol=0)
    assert picture_contours(placed.mask, RegistrationSettings(valley_weight=0.0), image=image).valleys is None
    grey = picture_contours(placed.mask, image=image.float().mean(-1)).valleys
    assert grey is not None
    torch.testing.assert_close(grey.sample(probe)[0], distance, atol=0.6, rtol=0)


def test_what_is_ignored_is_no_contour(studio: Any) -> None:
    mask = studio.placed().mask
    ignored = torch.zeros_like(mask)
    ignored[90:] = True
    found = picture_contours(mask, ignored=ignored)
    assert float(found.boundary.points_px[:, 1].max()) < 90
    assert picture_contours(mask, ignored=torch.ones_like(mask)).is_empty
    assert picture_contours(torch.zeros_like(mask)).is_empty


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("levels", ()),
        ("directions", 0),
        ("boundary_points", 3),
        ("hypotheses_at_once", 0),
        ("contour_std_px", 0.0),
        ("turn_share", -1.0),
        ("coverage_weight", -1.0),
        ("prior_weight", float("inf")),
    ],
)
def test_settings_say_what_is_wrong(field: str, value: Any) -> None:
    with pytest.raises(ValueError, match=f"registration.{field}: expected"):
        RegistrationSettings(**{field: value})


@pytest.mark.parametrize(("field", "value"), [("pitch_px", 0), ("rounds", 0), ("iterations", 0), ("robust_share", 0.0)])
def test_levels_say_what_is_wrong(field: str, value: Any) -> None:
    with pytest.raises(ValueError, match=f"level.{field}: expected"):
        RegistrationLevel(**{field: value})
