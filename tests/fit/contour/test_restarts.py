"""Restarts: hands whose fingers lie on other fingers come off them, others stay, and none touches another."""

import math
from dataclasses import replace
from typing import Any

import pytest
import torch

import torchhand.fit.contour.restarts
from tests.fit.contour.test_fit import SPACE, Case
from torchhand.fit import GaussianPrior, PosturePrior, PostureResiduals, Problem, Schedule, Solutions, solve
from torchhand.fit.contour import Restarts, RestartSettings, picture_contours, solve_with_restarts
from torchhand.fit.contour.settings import SEARCH, THIN_SEARCH, WIDE_SEARCH
from torchhand.geometry import rotation_from_vector
from torchhand.hand import HandPose

OFF_DEG = 15.0  # more than lies between two fingers


@pytest.fixture(scope="module")
def case(studio: Any) -> Case:
    return Case(studio)


@pytest.fixture(scope="module")
def postures(case: Case) -> PostureResiduals:
    return PostureResiduals.of(case.model.prior().postures)


@pytest.fixture(scope="module")
def starts(case: Case) -> HandPose:
    """Turned in the picture by more than lies between two fingers, to either side; and one that is right."""
    ahead = case.placed.camera.rotation[2].double()
    turns = torch.tensor((OFF_DEG, -OFF_DEG, 0.0), dtype=torch.float64).deg2rad()[:, None] * ahead
    return HandPose.of(case.truth.dofs.expand(3, -1), rotation_from_vector(turns) @ case.truth.reference)


@pytest.fixture(scope="module")
def problem(case: Case, starts: HandPose, postures: PostureResiduals) -> Problem:
    std = torch.full((SPACE.size,), 0.15, dtype=torch.float64)
    std[:3] = 0.01
    expected = GaussianPrior.of_std(starts, std, SPACE)
    picture = picture_contours(case.placed.mask, (*WIDE_SEARCH, *SEARCH))
    return case.problem(picture, (PosturePrior(postures=postures, is_normalized=True), expected))


def restarts(case: Case, known: PostureResiduals | None = None, **settings: Any) -> Restarts:
    return Restarts(
        settings=RestartSettings(**settings), camera=case.placed.camera.to(dtype=torch.float64), postures=known
    )


def fraction(found: Solutions) -> torch.Tensor:
    return found.explained_by("contour").fraction


def test_fingers_come_off_other_fingers(
    case: Case, problem: Problem, starts: HandPose, postures: PostureResiduals
) -> None:
    plain = solve(problem, starts, SEARCH)
    found = solve_with_restarts(problem, starts, SEARCH, restarts(case, postures))
    assert float(fraction(plain)[:2].min()) < 0.9
    assert bool((found.cost <= plain.cost).all())
    better = found.cost < plain.cost
    assert bool(better.any())
    wrong = case.errors(plain.pose)[1][better].mean()
    assert float(case.errors(found.pose)[1][better].mean()) < 0.5 * float(wrong)
    torch.testing.assert_close(found.cost[2], plain.cost[2])  # explained: not started again
    assert int(found.iterations[2]) == int(plain.iterations[2]) < int(found.iterations[0])


def test_restarts_go_through_every_finer_stage(
    case: Case, problem: Problem, starts: HandPose, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the last of their own stages, not from far off into the finest; the last stage in any case."""
    widths: list[tuple[float, ...]] = []

    def spied(problem: Problem, begun: HandPose, schedule: Schedule, **options: Any) -> Solutions:
        widths.append(tuple(stage.gross_m for stage in schedule))
        return solve(problem, begun, schedule, **options)

    monkeypatch.setattr(torchhand.fit.contour.restarts, "solve", spied)
    solve_with_restarts(problem, starts, THIN_SEARCH, restarts(case))
    wide = tuple(stage.gross_m for stage in WIDE_SEARCH)
    assert widths[1:] == [wide, tuple(stage.gross_m for stage in THIN_SEARCH if stage.gross_m < wide[-1])]
    assert len(set(widths[2])) > 1
    widths.clear()
    solve_with_restarts(problem, starts, WIDE_SEARCH[:2], restarts(case, min_fraction=1.0))
    assert widths[2] == wide[1:2]


def test_none_where_none_are_wanted(case: Case, problem: Problem, starts: HandPose) -> None:
    plain = solve(problem, starts, SEARCH)
    found = solve_with_restarts(problem, starts, SEARCH, restarts(case, min_fraction=0.0))
    torch.testing.assert_close(found.pose.dofs, plain.pose.dofs, atol=0, rtol=0)
    torch.testing.assert_close(found.cost, plain.cost, atol=0, rtol=0)


def test_one_hypothesis_never_touches_another(
    case: Case, problem: Problem, starts: HandPose, postures: PostureResiduals
) -> None:
    among = solve_with_restarts(problem, starts.reshape(3, 1), SEARCH, restarts(case, postures))
    assert among.cost.shape == (3, 1)
    for i in range(3):
        alone = solve_with_restarts(problem.rows(slice(i, i + 1)), starts[i : i + 1], SEARCH, restarts(case, postures))
        torch.testing.assert_close(among.cost[i], alone.cost, rtol=1e-6, atol=1e-6)
        torch.testing.assert_close(among.pose.dofs[i], alone.pose.dofs, rtol=0, atol=1e-5)
        torch.testing.assert_close(fraction(among)[i : i + 1], fraction(alone))


def test_restarts_are_turned_in_the_picture_or_in_other_postures(
    case: Case, starts: HandPose, postures: PostureResiduals
) -> None:
    hands = HandPose.of(starts.dofs + 0.01, starts.reference)
    begun = restarts(case, postures, postures=1).beside(hands, starts)
    assert begun.batch_shape == (4, 3)
    torch.testing.assert_close(begun[0].dofs, starts.dofs)
    torch.testing.assert_close(begun[0].reference, starts.reference)
    ahead = case.placed.camera.rotation[2].double()
    for own, sign in zip((begun[1], begun[2]), (1, -1), strict=True):
        expected = rotation_from_vector(sign * math.radians(8) * ahead) @ hands.rotation
        torch.testing.assert_close(own.rotation, expected)
        torch.testing.assert_close(own.dofs[:, 6:], starts.dofs[:, 6:])
        torch.testing.assert_close(own.dofs[:, :3], hands.dofs[:, :3])
    torch.testing.assert_close(begun[3].rotation, hands.rotation)
    torch.testing.assert_close(begun[3].dofs[:, 6:], postures.nearest(starts.dofs, math.radians(10), 1)[:, 0])


@pytest.mark.parametrize(("name", "value"), [("min_fraction", 1.1), ("postures", 101)])
def test_settings_out_of_range(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"restarts.{name}: expected"):
        replace(RestartSettings(), **{name: value})
