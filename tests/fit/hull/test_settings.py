"""Settings of the fits into hulls say what they expect."""

import pytest

from torchhand.fit.hull.settings import HullFitSettings, HullLevel, HullStartSettings, HullTorqueSettings


@pytest.mark.parametrize(
    ("record", "field", "value", "message"),
    [
        (HullTorqueSettings, "iterations", 0, "hull_torque.iterations: expected 1 or more, got 0"),
        (HullTorqueSettings, "step_deg", 0.0, "hull_torque.step_deg: expected above 0"),
        (HullTorqueSettings, "least_step_deg", 2.0, "hull_torque.least_step_deg: expected at most step_deg, got 2.0"),
        (HullTorqueSettings, "outside_share", 1.0, "hull_torque.outside_share: expected 0 or more and below 1"),
        (HullTorqueSettings, "slack_m", float("nan"), "hull_torque.slack_m: expected a finite number"),
        (HullTorqueSettings, "least_torque", 1.0, "hull_torque.least_torque: expected 0 or more and below 1"),
        (HullLevel, "rounds", 0, "hull level.rounds: expected 1 or more"),
        (HullLevel, "robust_m", 0.0, "hull level.robust_m: expected above 0"),
        (HullFitSettings, "levels", (), "hull_fit.levels: expected at least one"),
        (HullFitSettings, "vertices", 0, "hull_fit.vertices: expected 1 or more"),
        (HullFitSettings, "std_m", 0.0, "hull_fit.std_m: expected above 0"),
        (HullFitSettings, "covered_weight", -1.0, "hull_fit.covered_weight: expected 0 or more"),
        (HullFitSettings, "surface_weight", -1.0, "hull_fit.surface_weight: expected 0 or more"),
        (HullFitSettings, "near_m", 0.0, "hull_fit.near_m: expected above 0"),
        (HullFitSettings, "least_covered", 1.1, "hull_fit.least_covered: expected 0 to 1, got 1.1"),
        (HullFitSettings, "least_held", -0.1, "hull_fit.least_held: expected 0 to 1"),
        (HullFitSettings, "slack_m", float("inf"), "hull_fit.slack_m: expected a finite number"),
        (HullStartSettings, "rolls", 0, "hull_start.rolls: expected 1 or more"),
        (HullStartSettings, "rays", 0, "hull_start.rays: expected 1 or more"),
        (HullStartSettings, "varied", 0, "hull_start.varied: expected 1 or more"),
        (HullStartSettings, "postures", (), "hull_start.postures: expected at least one"),
        (HullStartSettings, "far_m", 0.0, "hull_start.far_m: expected above 0"),
    ],
)
def test_what_is_wrong_is_named(record: type, field: str, value: object, message: str) -> None:
    with pytest.raises(ValueError, match=message.replace(".", r"\.")):
        record(**{field: value})
    assert record() == record()
