"""Settings of the hypothesis study: iterations shared out over the stages, and ranges."""

from typing import Any

import pytest

from torchhand.fit import Schedule, Stage
from torchhand.fit.contour import SEARCH, TRACKING
from torchhand.study.hypotheses.settings import HypothesisStudySettings, total_iterations, with_iterations


def test_twenty_iterations_unless_told_otherwise() -> None:
    schedule = HypothesisStudySettings().schedule
    assert total_iterations(schedule) == 20
    assert with_iterations(schedule, 20) == schedule


@pytest.mark.parametrize("schedule", [SEARCH, TRACKING, (Stage(gross_m=0.01, rounds=3, iterations=50),)])
@pytest.mark.parametrize("maximum", [6, 7, 13, 21, 40, 200])
def test_iterations_are_shared_out(schedule: Schedule, maximum: int) -> None:
    shared = with_iterations(schedule, maximum)
    min_rounds = min(stage.rounds for stage in schedule)
    assert maximum - min_rounds < total_iterations(shared) <= maximum
    for before, after in zip(schedule, shared, strict=True):
        assert (after.rounds, after.gross_m, after.pitch_px) == (before.rounds, before.gross_m, before.pitch_px)


def test_few_iterations_still_leave_one_to_every_round() -> None:
    uneven = tuple(Stage(gross_m=0.01, rounds=1, iterations=count) for count in (100, 1, 1, 1))
    assert [stage.iterations for stage in with_iterations(uneven, 6)] == [3, 1, 1, 1]
    with pytest.raises(ValueError, match="iterations: expected 4 or more, one for each round of the schedule, got 3"):
        with_iterations(uneven, 3)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"starts": 0}, "starts: expected 1 to 10000000, got 0"),
        ({"batch": 5000}, "batch: expected 1 to 4096, got 5000"),
        (
            {"space": "planar"},
            "space: expected one of planar_abduction, dof26, dof27, dof28, dof31, dof36, got 'planar'",
        ),
        ({"points_per_arc": 3}, "points_per_arc: expected 4 or more, got 3"),
        ({"success_deg": 0.0}, "success_deg: expected above 0 and finite, got 0.0"),
        ({"best_of": (4, 2)}, r"best_of: expected increasing whole numbers from 1 on, got \(4, 2\)"),
        ({"best_of": ()}, "best_of: expected increasing whole numbers"),
        ({"schedule": ()}, "schedule: expected at least one stage"),
    ],
)
def test_mistakes_are_named(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        HypothesisStudySettings(**given)
