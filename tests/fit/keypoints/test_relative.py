"""Points in space whose place and size say nothing: their cost, its derivatives, and what it does not depend on."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from tests.studio import Studio
from torchhand.files import load_hand_model
from torchhand.fit import PopulationPrior, PosedHands, SharedUnknowns, Stage
from torchhand.fit.keypoints.relative import RelativeKeypoints
from torchhand.geometry import rotation_from_vector
from torchhand.hand import DOFS, Anthropometry, HandPose, posture

DOUBLE = torch.float64
KINEMATICS = load_hand_model().kinematics("right", dtype=DOUBLE)
STAGE = Stage(gross_m=0.01)
STD = torch.tensor((0.008, 0.008, 0.012), dtype=DOUBLE)


def _poses(count: int, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    poses = posture("flat", dtype=torch.float64).to(DOUBLE).repeat(count, 1)
    poses[:, 6:] += 0.1 * torch.rand(count, len(DOFS) - 6, generator=generator, dtype=DOUBLE)
    poses[:, :3] = torch.tensor((0.02, -0.03, 0.5), dtype=DOUBLE)
    return poses


def _hands(poses: Tensor) -> PosedHands:
    return PosedHands(pose=HandPose.of(poses, torch.eye(3, dtype=DOUBLE)), shape=KINEMATICS.default_shape)


def _observed(points: Tensor, turn: Tensor | None = None) -> RelativeKeypoints:
    axes = (torch.eye(3, dtype=DOUBLE) if turn is None else turn)[None]
    return RelativeKeypoints(points=points, kinematics=KINEMATICS, cam_from_world=axes, std=STD)


def _cost(observed: RelativeKeypoints, poses: Tensor) -> Tensor:
    hands = _hands(poses)
    return observed.associate(hands, STAGE).equations(hands).cost


def test_place_and_size_of_the_points_say_nothing() -> None:
    poses, others = _poses(3), _poses(3, seed=1)
    points = KINEMATICS(others, KINEMATICS.default_shape).keypoints
    turn = rotation_from_vector(torch.tensor((0.3, -0.2, 0.5), dtype=DOUBLE))
    in_camera = points @ turn.T
    cost = _cost(_observed(in_camera, turn), poses)
    moved = _cost(_observed(in_camera + torch.tensor((1.0, 2.0, -3.0), dtype=DOUBLE), turn), poses)
    torch.testing.assert_close(moved, cost, rtol=1e-9, atol=1e-12)
    larger = _cost(_observed(1.7 * in_camera, turn), poses)
    torch.testing.assert_close(larger, 1.7**2 * cost, rtol=1e-9, atol=1e-12)
    exact = _cost(_observed(0.6 * in_camera + 0.2, turn), others)
    torch.testing.assert_close(exact, torch.zeros_like(exact), rtol=0.0, atol=1e-18)


def test_a_missing_point_says_nothing() -> None:
    poses = _poses(2)
    points = KINEMATICS(_poses(2, seed=1), KINEMATICS.default_shape).keypoints
    points[:, 7] = torch.nan
    holes = _cost(_observed(points), poses)
    hands = _hands(poses)
    keypoints = KINEMATICS(poses, KINEMATICS.default_shape).keypoints
    known = [i for i in range(21) if i != 7]
    own, seen = ((part - part.mean(1, keepdim=True)) / STD for part in (keypoints[:, known], points[:, known]))
    scale = (own * seen).sum((1, 2)) / own.square().sum((1, 2))
    expected = 0.5 * (scale[:, None, None] * own - seen).square().sum((1, 2))
    torch.testing.assert_close(holes, expected, rtol=1e-9, atol=1e-12)
    gradient = _observed(points).associate(hands, STAGE).equations(hands).gradient
    assert bool(gradient.isfinite().all())


@pytest.mark.parametrize("seed", [2, 3])
def test_the_gradient_is_that_of_the_cost(seed: int) -> None:
    poses = _poses(1, seed=seed)
    observed = _observed(KINEMATICS(_poses(1, seed=9), KINEMATICS.default_shape).keypoints)
    hands = _hands(poses)
    gradient = observed.associate(hands, STAGE).equations(hands).gradient[0]
    step, numeric = 1e-6, []
    for dof in range(6, len(DOFS)):  # the root's rotation is a left perturbation, its place changes nothing
        away = torch.zeros(len(DOFS), dtype=DOUBLE)
        away[dof] = step
        numeric.append((_cost(observed, poses + away) - _cost(observed, poses - away))[0] / (2 * step))
    torch.testing.assert_close(gradient[6:], torch.stack(numeric), rtol=1e-5, atol=1e-6)
    torch.testing.assert_close(gradient[:3], torch.zeros(3, dtype=DOUBLE), rtol=0.0, atol=1e-9)


def test_frames_are_independent_of_each_other() -> None:
    poses = _poses(4)
    points = KINEMATICS(_poses(4, seed=1), KINEMATICS.default_shape).keypoints
    whole = _cost(_observed(points), poses)
    some = _observed(points).rows(torch.tensor([2, 0]))
    torch.testing.assert_close(_cost(some, poses[[2, 0]]), whole[[2, 0]], rtol=1e-12, atol=0.0)


def test_points_of_one_frame_are_compared_with_any_number_of_hypotheses() -> None:
    """As many rows of the same points give the same equations; a camera's axes are those of the points."""
    poses = _poses(3)
    turn = rotation_from_vector(torch.tensor((0.3, -0.2, 0.5), dtype=DOUBLE))
    camera = replace(Studio().camera(), rotation=turn)
    points = KINEMATICS(_poses(1, seed=1), KINEMATICS.default_shape).keypoints @ turn.T
    one, hands = RelativeKeypoints.of_points(points, KINEMATICS, camera), _hands(poses)
    found = one.rows(torch.tensor([0, 0, 0])).associate(hands, STAGE).equations(hands)
    expected = _observed(points.expand(3, -1, -1), turn).associate(hands, STAGE).equations(hands)
    for name in ("cost", "gradient", "matrix"):
        torch.testing.assert_close(getattr(found, name), getattr(expected, name), rtol=1e-12, atol=1e-12)
    some = one.associate(hands, STAGE).rows(torch.tensor([2]))
    torch.testing.assert_close(some.equations(_hands(poses[2:])).cost, expected.cost[2:], rtol=1e-12, atol=0)


def test_a_larger_hand_is_no_information() -> None:
    """What the best size makes good does not count in the second derivative either: longer, broader hands cost
    nothing."""
    poses, space = _poses(2), KINEMATICS.shape_space
    nothing = torch.zeros(0, dtype=DOUBLE)
    unknowns = SharedUnknowns(
        columns=tuple(space.names.index(name) for name in ("hand_length", "hand_breadth")),
        prior=PopulationPrior(population=Anthropometry(space)),
        lower=space.lower,
        upper=space.upper,
        extra=nothing,
        extra_std=nothing,
    )
    hands = replace(_hands(poses), unknowns=unknowns)
    observed = _observed(KINEMATICS(_poses(2, seed=1), KINEMATICS.default_shape).keypoints)
    found = observed.associate(hands, STAGE).equations(hands)
    assert found.shared_matrix is not None
    grown = unknowns.vector(KINEMATICS.default_shape)
    of_size = (grown @ found.shared_matrix @ grown).abs()
    assert float(of_size.max()) < 1e-9 * float(
        (grown.square() @ found.shared_matrix.diagonal(dim1=-2, dim2=-1).T).min()
    )
