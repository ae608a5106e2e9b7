"""Settings of the fits into hulls say what they expect."""

import pytest

from torchhand.fit.hull.settings import (
    HullSettings,
    HullShapeSettings,
    HullStartSettings,
    HullTorqueSettings,
    JointPriorWeights,
)


@pytest.mark.parametrize(
    ("record", "field", "value", "message"),
    [
        (HullTorqueSettings, "iterations", 0, "hull_torque.iterations: expected 1 or more, got 0"),
        (HullTorqueSettings, "step_deg", 0.0, "hull_torque.step_deg: expected above 0"),
        (HullTorqueSettings, "min_step_deg", 2.0, "hull_torque.min_step_deg: expected at most step_deg, got 2.0"),
        (HullTorqueSettings, "outside_fraction", 1.0, "hull_torque.outside_fraction: expected 0 or more and below 1"),
        (HullTorqueSettings, "slack_m", float("nan"), "hull_torque.slack_m: expected a finite number"),
        (HullTorqueSettings, "min_torque", 1.0, "hull_torque.min_torque: expected 0 or more and below 1"),
        (HullSettings, "vertices", 0, "hull.vertices: expected 1 or more"),
        (HullSettings, "std_m", 0.0, "hull.std_m: expected above 0"),
        (HullSettings, "edge_weight", -1.0, "hull.edge_weight: expected 0 or more"),
        (HullSettings, "surface_weight", -1.0, "hull.surface_weight: expected 0 or more"),
        (HullSettings, "near_m", 0.0, "hull.near_m: expected above 0"),
        (HullSettings, "slack_m", float("inf"), "hull.slack_m: expected a finite number"),
        (JointPriorWeights, "postures", -0.1, "joints.postures: expected 0 or more"),
        (JointPriorWeights, "posture_tail", 0.0, "joints.posture_tail: expected above 0"),
        (HullShapeSettings, "rounds", 0, "hull_shape.rounds: expected 1 or more, got 0"),
        (HullShapeSettings, "gross_m", (0.01, 0.0), "hull_shape.gross_m: expected above 0"),
        (HullStartSettings, "rolls", 0, "hull_start.rolls: expected 1 or more"),
        (HullStartSettings, "rays", 0, "hull_start.rays: expected 1 or more"),
        (HullStartSettings, "finger_hypotheses", 0, "hull_start.finger_hypotheses: expected 1 or more"),
        (HullStartSettings, "postures", (), "hull_start.postures: expected at least one"),
    ],
)
def test_what_is_wrong_is_named(record: type, field: str, value: object, message: str) -> None:
    with pytest.raises(ValueError, match=message.replace(".", r"\.")):
        record(**{field: value})
    assert record() == record()


def test_rounds_of_the_shape_fit_shrink_evenly() -> None:
    gross = [stage.gross_m for stage in HullShapeSettings(rounds=4, gross_m=(0.008, 0.001)).schedule]
    assert gross == pytest.approx([0.008, 0.004, 0.002, 0.001])
    assert [stage.gross_m for stage in HullShapeSettings(rounds=1, gross_m=(0.008, 0.001)).schedule] == [0.008]
