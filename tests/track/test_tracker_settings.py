"""Settings of the contour tracker: every range says which field, what is allowed and what was given."""

import dataclasses
import math

import pytest

from torchhand.fit.detect import FitSettings
from torchhand.hand import POSE_SPACES, POSTURES
from torchhand.track.settings import ContourTrackerSettings, LightSettings, LossSettings, NoiseSettings, PriorSettings

_POSITIVE = ("edge_std_px", "gate", "search_share")
_LEAST = {"passes": 1, "points_per_generator": 2, "points_per_arc": 4, "check_side_px": 64}
_SHARES = ("min_overlap", "min_found", "min_inside", "start_overlap", "doubt_drop", "better_by", "turned_by")

CASES = [
    *[(ContourTrackerSettings, name, 0.0, f"{name}: expected above 0 and finite, got 0.0") for name in _POSITIVE],
    *[
        (ContourTrackerSettings, name, least - 1, f"{name}: expected {least} or more, got {least - 1}")
        for name, least in _LEAST.items()
    ],
    (ContourTrackerSettings, "gate", math.inf, "gate: expected above 0 and finite, got inf"),
    (ContourTrackerSettings, "edge_std_px", math.nan, "edge_std_px: expected above 0 and finite, got nan"),
    (ContourTrackerSettings, "inner_weight", -0.1, "inner_weight: expected 0 or more and finite, got -0.1"),
    (
        ContourTrackerSettings,
        "pose_space",
        "dof99",
        f"pose_space: expected one of {', '.join(POSE_SPACES)}, got 'dof99'",
    ),
    (ContourTrackerSettings, "posture", "wave", f"posture: expected one of {', '.join(POSTURES)}, got 'wave'"),
    *[
        (NoiseSettings, name, -1.0, f"noise.{name}: expected 0 or more and finite, got -1.0")
        for name in ("translation", "rotation", "angle")
    ],
    (NoiseSettings, "angle", math.nan, "noise.angle: expected 0 or more and finite, got nan"),
    *[
        (PriorSettings, name, 0.0, f"prior.{name}: expected above 0 and finite, got 0.0")
        for name in ("rest_std_rad", "side_std_rad", "tie_std_rad", "tilt_std_rad")
    ],
    *[(LossSettings, name, 1.5, f"loss.{name}: expected 0 to 1, got 1.5") for name in _SHARES],
    *[(LossSettings, name, -0.5, f"loss.{name}: expected 0 to 1, got -0.5") for name in _SHARES],
    (LossSettings, "doubt_unexplained", -1.0, "loss.doubt_unexplained: expected 0 or more, got -1.0"),
    *[(LossSettings, name, 0, f"loss.{name}: expected 1 or more, got 0") for name in ("patience", "search_every")],
    (LightSettings, "every", -1, "light.every: expected 0 or more, got -1"),
    (LightSettings, "keep", 1.5, "light.keep: expected 0 to 1, got 1.5"),
    *[
        (FitSettings, name, -2.0, f"fit.{name}: expected above 0 and finite, got -2.0")
        for name in ("search_share", "final_search_share", "edge_std_px", "bent_std_rad")
    ],
    (FitSettings, "iterations", 0, "fit.iterations: expected 1 or more, got 0"),
]


@pytest.mark.parametrize(("settings", "name", "value", "message"), CASES)
def test_a_value_that_cannot_be(settings: type, name: str, value: object, message: str) -> None:
    with pytest.raises(ValueError) as raised:
        settings(**{name: value})
    assert str(raised.value) == message


def test_every_number_of_the_tracker_is_checked() -> None:
    checked = {(settings, name) for settings, name, _, _ in CASES}
    for settings in (ContourTrackerSettings, NoiseSettings, PriorSettings, LossSettings, FitSettings):
        for field in dataclasses.fields(settings):
            if field.type in (int, float):
                assert (settings, field.name) in checked, f"{settings.__name__}.{field.name}"


def test_ends_of_the_ranges_are_allowed() -> None:
    LossSettings(min_overlap=0.0, min_found=1.0, patience=1, search_every=1)
    NoiseSettings(translation=0.0, rotation=0.0, angle=0.0)
    kept = ContourTrackerSettings(inner_weight=0.0, passes=1, points_per_generator=2, points_per_arc=4)
    assert (kept.inner_weight, kept.points_per_generator) == (0.0, 2)


def test_settings_cannot_be_changed() -> None:
    settings = ContourTrackerSettings()
    with pytest.raises(dataclasses.FrozenInstanceError):
        settings.gate = 4.0  # type: ignore[misc]
