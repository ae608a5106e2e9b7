"""Settings of the tracker: every range says which field, what is allowed and what was given."""

import dataclasses
import math

import pytest

from torchhand.fit.detect import FitSettings
from torchhand.fit.keypoints import KeypointSettings
from torchhand.hand import POSE_SPACES, POSTURES
from torchhand.track import DEFAULTS, TrackerSettings
from torchhand.track.belief import NoiseSettings, PosturePriorSettings
from torchhand.track.extended import ExtendedUpdateSettings
from torchhand.track.multiview import RigSettings
from torchhand.track.scene import HealthSettings
from torchhand.track.unscented import UnscentedUpdateSettings

_FRACTIONS = (
    "min_overlap",
    "min_edges",
    "found_overlap",
    "edge_weight",
    "memory",
    "max_score_drop",
    "better_by",
    "turned_by",
    "nearer_by",
)
_PRIOR = ("rest_std_rad", "tie_std_rad", "tilt_std_rad")

CASES = [
    *[
        (TrackerSettings, name, minimum - 1, f"{name}: expected {minimum} or more, got {minimum - 1}")
        for name, minimum in {
            "points_per_generator": 2,
            "points_per_arc": 4,
            "colour_update_every": 0,
            "shape_frames": 0,
            "max_pixels": 10_000,
            "check_side_px": 64,
        }.items()
    ],
    (TrackerSettings, "smoothing_window_s", -1.0, "smoothing_window_s: expected 0 or more and finite, got -1.0"),
    (TrackerSettings, "pose_space", "dof99", f"pose_space: expected one of {', '.join(POSE_SPACES)}, got 'dof99'"),
    (TrackerSettings, "posture", "wave", f"posture: expected one of {', '.join(POSTURES)}, got 'wave'"),
    *[
        (UnscentedUpdateSettings, name, 0.0, f"update.{name}: expected above 0 and finite, got 0.0")
        for name in ("edge_std_px", "gate", "search_fraction")
    ],
    (UnscentedUpdateSettings, "gate", math.inf, "update.gate: expected above 0 and finite, got inf"),
    (UnscentedUpdateSettings, "edge_std_px", math.nan, "update.edge_std_px: expected above 0 and finite, got nan"),
    (UnscentedUpdateSettings, "passes", 0, "update.passes: expected 1 or more, got 0"),
    (UnscentedUpdateSettings, "inner_weight", -0.1, "update.inner_weight: expected 0 or more and finite, got -0.1"),
    (ExtendedUpdateSettings, "gate", 0.0, "update.gate: expected above 0 and finite, got 0.0"),
    *[
        (ExtendedUpdateSettings, name, -1.0, f"update.{name}: expected 0 or more and finite, got -1.0")
        for name in ("pose_weight", "constraint_weight", "prior_weight")
    ],
    (ExtendedUpdateSettings, "finger_proposals", 11, "update.finger_proposals: expected 0 to 10, got 11"),
    *[
        (NoiseSettings, name, -1.0, f"noise.{name}: expected 0 or more and finite, got -1.0")
        for name in ("translation", "rotation", "angle")
    ],
    (NoiseSettings, "angle", math.nan, "noise.angle: expected 0 or more and finite, got nan"),
    *[(PosturePriorSettings, name, 0.0, f"prior.{name}: expected above 0 and finite, got 0.0") for name in _PRIOR],
    *[(HealthSettings, name, 1.5, f"health.{name}: expected 0 to 1, got 1.5") for name in _FRACTIONS],
    *[(HealthSettings, name, -0.5, f"health.{name}: expected 0 to 1, got -0.5") for name in _FRACTIONS],
    (HealthSettings, "max_unexplained", -1.0, "health.max_unexplained: expected 0 or more, got -1.0"),
    *[
        (HealthSettings, name, 0, f"health.{name}: expected 1 or more, got 0")
        for name in ("patience", "search_every", "alternatives_at_most_every")
    ],
    (HealthSettings, "search_at_most_every", 2, "health.search_at_most_every: expected search_every or more, got 2"),
    (FitSettings, "edge_std_px", -2.0, "fit.edge_std_px: expected above 0 and finite, got -2.0"),
    (FitSettings, "iterations", 0, "fit.iterations: expected 1 or more, got 0"),
    (RigSettings, "min_views", 1, "rig.min_views: expected 2 or more, got 1"),
    (RigSettings, "shape_frames", -1, "rig.shape_frames: expected 0 or more, got -1"),
    (RigSettings, "tracking_vertices", 0, "rig.tracking_vertices: expected 1 or more, got 0"),
]


@pytest.mark.parametrize(("settings", "name", "value", "message"), CASES)
def test_a_value_that_cannot_be(settings: type, name: str, value: object, message: str) -> None:
    with pytest.raises(ValueError) as raised:
        settings(**{name: value})
    assert str(raised.value) == message


def test_every_number_of_the_tracker_is_checked() -> None:
    checked = {(settings, name) for settings, name, _, _ in CASES}
    for settings in {case[0] for case in CASES}:
        for field in dataclasses.fields(settings):
            if field.type in (int, float):
                assert (settings, field.name) in checked, f"{settings.__name__}.{field.name}"


def test_ends_of_the_ranges_are_allowed() -> None:
    HealthSettings(min_overlap=0.0, min_edges=1.0, patience=1, search_every=1)
    NoiseSettings(translation=0.0, rotation=0.0, angle=0.0)
    TrackerSettings(points_per_generator=2, points_per_arc=4, smoothing_window_s=0.0)
    assert UnscentedUpdateSettings(inner_weight=0.0, passes=1).inner_weight == 0.0
    KeypointSettings()


def test_every_method_has_defaults_of_its_own() -> None:
    assert {name: settings.method for name, settings in DEFAULTS.items()} == {name: name for name in DEFAULTS}


def test_settings_cannot_be_changed() -> None:
    settings = TrackerSettings()
    with pytest.raises(dataclasses.FrozenInstanceError):
        settings.pose_space = "dof26"  # type: ignore[misc]
