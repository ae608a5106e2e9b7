"""Settings of the hypothesis study: iterations shared out over the levels, and ranges."""

from typing import Any

import pytest

from torchhand.fit.contour import LEVELS, TRACKING_LEVELS, RegistrationLevel
from torchhand.study.hypotheses.settings import HypothesisStudySettings, total_iterations, with_iterations


def test_twenty_iterations_unless_told_otherwise() -> None:
    levels = HypothesisStudySettings().registration.levels
    assert total_iterations(levels) == 20
    assert with_iterations(levels, 20) == levels


@pytest.mark.parametrize("levels", [LEVELS, TRACKING_LEVELS, (RegistrationLevel(rounds=3, iterations=50),)])
@pytest.mark.parametrize("most", [6, 7, 13, 21, 40, 200])
def test_iterations_are_shared_out(levels: tuple[RegistrationLevel, ...], most: int) -> None:
    shared = with_iterations(levels, most)
    fewest_looks = min(level.rounds for level in levels)
    assert most - fewest_looks < total_iterations(shared) <= most
    for before, after in zip(levels, shared, strict=True):
        assert (after.rounds, after.robust_share, after.pitch_px) == (
            before.rounds,
            before.robust_share,
            before.pitch_px,
        )


def test_few_iterations_still_leave_one_to_every_look() -> None:
    uneven = (RegistrationLevel(rounds=1, iterations=100), *(RegistrationLevel(rounds=1, iterations=1),) * 3)
    assert [level.iterations for level in with_iterations(uneven, 6)] == [3, 1, 1, 1]
    with pytest.raises(ValueError, match="iterations: expected 4 or more, one for each look of the levels, got 3"):
        with_iterations(uneven, 3)


def test_the_engine_works_on_a_batch_at_once() -> None:
    assert HypothesisStudySettings(batch=7).engine.hypotheses_at_once == 7


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
    ],
)
def test_mistakes_are_named(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        HypothesisStudySettings(**given)
