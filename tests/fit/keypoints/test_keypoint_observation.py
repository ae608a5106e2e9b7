"""Keypoints as factors: exact derivatives, invariance to what they cannot tell, missing points and outliers."""

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.fit import Observation, PosedHands, Problem, SharedUnknowns, Stage, solve
from torchhand.fit.keypoints.observation import PictureKeypoints
from torchhand.fit.keypoints.points import Detector, KeypointSettings
from torchhand.fit.keypoints.posture import PostureKeypoints
from torchhand.fit.keypoints.rig import ViewLag
from torchhand.fit.keypoints.world import WorldKeypoints
from torchhand.geometry import assumed_camera, rotation_from_vector
from torchhand.hand import Anthropometry, HandPose, Side, named_pose_space, posture
from torchhand.hand.limits import clamp_to_limits
from torchhand.numerics import RobustLoss

FINE = Stage(gross_m=0.004, rounds=3, iterations=10)
SPACE = named_pose_space("dof27")
KINEMATICS = load_hand_model().kinematics(dtype=torch.float64)
CAMERA = assumed_camera(640, 480, horizontal_fov_deg=50.0)


def _hands(count: int, seed: int, spread: float = 0.2) -> HandPose:
    generator = torch.Generator().manual_seed(seed)
    free = SPACE.free(posture("open", dtype=torch.float64).double())
    free = free + spread * torch.randn(count, SPACE.size, generator=generator, dtype=torch.float64)
    dofs = clamp_to_limits(SPACE.dof(free), KINEMATICS.skeleton)
    dofs[:, :3] = torch.tensor((0.02, 0.05, 0.5), dtype=torch.float64)
    dofs[:, 3:6] = 0
    reference = rotation_from_vector(0.5 * torch.randn(count, 3, generator=generator, dtype=torch.float64))
    return HandPose(dofs=dofs, reference=reference)


def _posed(pose: HandPose) -> PosedHands:
    return PosedHands(pose=pose, shape=KINEMATICS.default_shape)


def _keypoints(pose: HandPose) -> Tensor:
    return KINEMATICS(pose.dofs, root_reference=pose.reference).keypoints


def _posture(points: Tensor, settings: KeypointSettings) -> PostureKeypoints:
    return PostureKeypoints.of_points(points, KINEMATICS, KINEMATICS.default_shape, settings)


def _observations(truth: HandPose) -> dict[str, Observation]:
    points, settings = _keypoints(truth), KeypointSettings()
    return {
        "picture": PictureKeypoints(
            points_px=CAMERA.project(points), kinematics=KINEMATICS, camera=CAMERA, settings=settings
        ),
        "space": _posture(points, settings),
    }


@pytest.mark.parametrize("kind", ["picture", "space"])
def test_the_gradient_is_that_of_the_cost(kind: str) -> None:
    observation, hands = _observations(_hands(3, 1))[kind], _hands(3, 2)
    factor = observation.associate(_posed(hands), FINE)
    found = factor.equations(_posed(hands))
    step = 1e-6
    for dof in range(36):
        moved = torch.zeros(36, dtype=torch.float64)
        moved[dof] = step
        costs = [
            factor.equations(_posed(HandPose(dofs=hands.dofs + sign * moved, reference=hands.reference))).cost
            for sign in (1, -1)
        ]
        numerical = (costs[0] - costs[1]) / (2 * step)
        scale = found.gradient.abs().amax(-1)
        own = dof - found.first_dof
        exact = found.gradient[:, own] if own >= 0 else torch.zeros(3, dtype=torch.float64)
        assert bool(((exact - numerical).abs() <= 1e-5 * scale + 1e-6).all()), dof


def _detector(seed: int) -> Detector:
    offsets = 0.004 * torch.randn(21, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    scale = torch.tensor(-0.3, dtype=torch.float64)
    return Detector(log_scale=scale, offsets=offsets, has_unknown_scale=True, has_unknown_offsets=True)


def _unknowns(detector: Detector) -> SharedUnknowns:
    """Two shape parameters and what is unknown of the detector."""
    population = Anthropometry(KINEMATICS.shape_space)
    columns = tuple(KINEMATICS.shape_space.names.index(name) for name in ("hand_length", "index_middle"))
    shape = SharedUnknowns.of_shape(population, columns)
    return replace(shape, extra=detector.extra, extra_std=torch.ones_like(detector.extra))


@pytest.mark.parametrize(
    ("kind", "side", "is_robust"),
    [("picture", "left", False), ("picture", "right", True), ("world", "left", True), ("world", "right", False)],
)
def test_the_gradient_in_what_frames_share_is_that_of_the_cost(kind: str, side: Side, is_robust: bool) -> None:
    """Shape, unit and offsets of the detector; and the pose, with all of them in effect."""
    kinematics, truth, hands, detector = load_hand_model().kinematics(side, dtype=torch.float64), *_pair(), _detector(3)
    points = kinematics(truth.dofs, root_reference=truth.reference).keypoints
    trust = torch.linspace(0.2, 1.0, 21, dtype=torch.float64).expand(3, -1)
    loss = RobustLoss(kind="huber", scale=2.0, group=2 if kind == "picture" else 3) if is_robust else None
    settings = KeypointSettings()
    observation: Observation
    if kind == "picture":
        observation = PictureKeypoints(
            points_px=CAMERA.project(points),
            kinematics=kinematics,
            camera=CAMERA,
            settings=settings,
            confidence=trust,
            std_px=torch.tensor((3.0, 5.0, 9.0), dtype=torch.float64),
            loss=loss,
            detector=detector,
        )
    else:
        observation = WorldKeypoints(
            points=1.3 * points,
            kinematics=kinematics,
            settings=settings,
            confidence=trust,
            loss=loss,
            detector=detector,
        )
    unknowns, shape = _unknowns(detector), KINEMATICS.default_shape

    def posed(pose: HandPose, vector: Tensor) -> PosedHands:
        return PosedHands(
            pose=pose, shape=unknowns.shape(vector, shape), unknowns=unknowns, extra=unknowns.extras(vector)
        )

    vector = unknowns.vector(shape)
    factor = observation.associate(posed(hands, vector), FINE)
    found = factor.equations(posed(hands, vector))
    assert found.shared_gradient is not None
    step = 1e-6
    for number, slope in enumerate(torch.cat((found.shared_gradient, found.gradient), -1).T):
        moved = torch.zeros(len(vector) + 36, dtype=torch.float64)
        moved[number] = step
        costs = []
        for change in (moved, -moved):
            pose = HandPose(dofs=hands.dofs + change[len(vector) :], reference=hands.reference)
            costs.append(factor.equations(posed(pose, vector + change[: len(vector)])).cost)
        numerical = (costs[0] - costs[1]) / (2 * step)
        torch.testing.assert_close(slope, numerical, rtol=1e-5, atol=1e-5 * float(numerical.abs().max() + 1))


def _pair() -> tuple[HandPose, HandPose]:
    return _hands(3, 1), _hands(3, 2)


@pytest.mark.parametrize("kind", ["picture", "world"])
def test_frames_are_rows(kind: str) -> None:
    """Points, confidences and cameras of a frame go with it, in the observation and in its factor."""
    truth, hands = _pair()
    points, shift = _keypoints(truth), torch.tensor((0.0, 30.0, -80.0), dtype=torch.float64)
    intrinsics = CAMERA.intrinsics.repeat(3, 1, 1)
    intrinsics[:, 0, 2] += shift
    cameras = replace(
        CAMERA,
        intrinsics=intrinsics,
        rotation=CAMERA.rotation.expand(3, 3, 3),
        translation=CAMERA.translation.expand(3, 3),
        distortion=CAMERA.distortion.expand(3, 0),
    )
    trust = torch.tensor((1.0, 0.5, 0.25), dtype=torch.float64)[:, None].repeat(1, 21)
    settings = KeypointSettings()
    frames = (
        PictureKeypoints(
            points_px=cameras.project(points),
            kinematics=KINEMATICS,
            camera=cameras,
            settings=settings,
            confidence=trust,
        )
        if kind == "picture"
        else WorldKeypoints(points=points, kinematics=KINEMATICS, settings=settings, confidence=trust)
    )
    whole = frames.associate(_posed(hands), FINE)
    costs = whole.equations(_posed(hands)).cost
    for rows in (torch.tensor([2]), torch.tensor([1, 0])):
        own = frames.rows(rows).associate(_posed(hands[rows]), FINE).equations(_posed(hands[rows])).cost
        torch.testing.assert_close(own, costs[rows], rtol=1e-12, atol=0)
        of_factor = whole.rows(rows).equations(_posed(hands[rows])).cost
        torch.testing.assert_close(of_factor, costs[rows], rtol=1e-12, atol=0)


def test_points_of_one_frame_of_a_late_camera_are_those_of_all_hands() -> None:
    """And of some of them, as where others are done."""
    hands = _hands(3, 9)
    path = CAMERA.project(_keypoints(_hands(5, 9, spread=0.02)))
    seen = PictureKeypoints(
        points_px=path[2:3],
        kinematics=KINEMATICS,
        camera=CAMERA,
        settings=KeypointSettings(),
        lag=replace(ViewLag.of(path, std=1.0, place=0), lag=torch.tensor(0.3, dtype=torch.float64)).rows(slice(2, 3)),
    )
    factor = seen.associate(_posed(hands), FINE)
    costs = factor.equations(_posed(hands)).cost
    rows = torch.tensor([2, 1])
    own = factor.rows(rows).equations(_posed(hands[rows])).cost
    torch.testing.assert_close(own, costs[rows], rtol=1e-12, atol=0)


def test_a_hand_behind_the_camera_is_no_solution() -> None:
    truth = _hands(2, 8)
    own = _observations(truth)["picture"]
    factor = own.associate(_posed(truth), FINE)
    behind = truth.dofs.clone()
    behind[1, 2] = -0.5
    cost = factor.equations(_posed(HandPose(dofs=behind, reference=truth.reference))).cost
    assert cost.isfinite().tolist() == [True, False]


def test_points_in_the_world_find_place_and_turn() -> None:
    """One wild point is no more than an outlier."""
    truth, starts = _hands(1, 5), _hands(4, 6, spread=0.1)
    points = _keypoints(truth)
    points[0, 12] += 0.3
    observation = WorldKeypoints(points=points, kinematics=KINEMATICS, settings=KeypointSettings())
    problem = Problem(
        space=SPACE, skeleton=KINEMATICS.skeleton, shape=KINEMATICS.default_shape, observations=(observation,)
    )
    schedule = (Stage(gross_m=0.05, rounds=3, iterations=20), Stage(gross_m=0.004, rounds=3, iterations=20))
    found = solve(problem, starts, schedule)
    others = [i for i in range(21) if i != 12]
    error = (_keypoints(found.pose) - _keypoints(truth))[:, others].norm(dim=-1)
    assert float(error.max()) < 1e-3


def test_points_in_space_tell_nothing_of_place_direction_and_size() -> None:
    truth, hands = _hands(1, 3), _hands(4, 4)
    turn = rotation_from_vector(torch.tensor((0.3, -1.0, 0.5), dtype=torch.float64))
    points = _keypoints(truth)
    moved = 1.7 * points @ turn.T + torch.tensor((0.3, 0.1, -0.2), dtype=torch.float64)
    costs = []
    for given in (points, moved):
        observation = _posture(given, KeypointSettings())
        found = observation.associate(_posed(hands), FINE).equations(_posed(hands))
        costs.append(found.cost)
        assert found.first_dof == 6  # the root is left out
    assert torch.allclose(costs[0], costs[1], rtol=1e-9, atol=0)


@pytest.mark.parametrize("missing", [(), (4,), (8, 12, 16, 20), tuple(range(5, 9))])
def test_both_together_recover_the_hand(missing: tuple[int, ...]) -> None:
    truth, starts = _hands(1, 5), _hands(6, 6, spread=0.1)
    own = _observations(truth)
    picture, space = own["picture"], own["space"]
    assert isinstance(picture, PictureKeypoints)
    assert isinstance(space, PostureKeypoints)
    picture.points_px[:, list(missing)] = torch.nan
    starts = HandPose(dofs=starts.dofs, reference=truth.reference.expand(6, 3, 3))
    problem = Problem(
        space=SPACE, skeleton=KINEMATICS.skeleton, shape=KINEMATICS.default_shape, observations=(picture, space)
    )
    schedule = (Stage(gross_m=0.05, rounds=3, iterations=20), Stage(gross_m=0.004, rounds=3, iterations=20))
    found = solve(problem, starts, schedule)
    best = found.select(found.best)
    error = (_keypoints(best.pose) - _keypoints(truth)[0]).norm(dim=-1)
    assert float(error.max()) < 2e-3  # the palm's own bend is not read from points


def test_a_point_that_jumped_counts_for_next_to_nothing() -> None:
    truth = _hands(1, 7)
    own = _observations(truth)["picture"]
    assert isinstance(own, PictureKeypoints)
    own.points_px[0, 8] += torch.tensor((60.0, -40.0))
    factor = own.associate(_posed(truth), FINE)
    assert float(factor.trust[0, 8]) < 0.05 * float(factor.trust[0, 12])
    _, variance, is_known = factor.measurement()
    assert bool(is_known.all())
    assert float(variance[16]) > 20 * float(variance[24])


def test_no_points_are_an_empty_observation() -> None:
    nothing = torch.full((1, 21, 2), math.nan, dtype=torch.float64)
    assert PictureKeypoints(
        points_px=nothing, kinematics=KINEMATICS, camera=CAMERA, settings=KeypointSettings()
    ).is_empty
