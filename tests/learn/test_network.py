"""The network's decoder: bounds, rotations, cameras, left hands."""

import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.geometry import rotation_from_vector
from torchhand.hand import JOINT_DOFS, Side
from torchhand.learn.estimate import estimate_hands
from torchhand.learn.network import PoseNetwork
from torchhand.learn.observation import observe

MODEL = load_hand_model()


def _network(*, wild: float = 1.0) -> PoseNetwork:
    """Random weights, the last layer's many times what they are at the start."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(1)
        network = PoseNetwork(MODEL, torch.full((30,), 0.1), width=24, blocks=1)
    with torch.no_grad():
        for parameter in network.leave.parameters():
            parameter *= wild
    return network


def _points(generator: torch.Generator, *batch: int) -> Tensor:
    return 0.15 * torch.randn(*batch, 21, 2, generator=generator) + torch.tensor((0.1, -0.05))


def test_nothing_leaves_its_bounds(generator: torch.Generator) -> None:
    points = _points(generator, 200)
    found = estimate_hands(_network(wild=40.0), points)
    joints, skeleton, space = found.pose[:, 6:].double(), MODEL.skeleton, MODEL.shape_space
    for value, low, high in (
        (joints, skeleton.lower, skeleton.upper),
        (found.shape.double(), space.lower, space.upper),
    ):
        assert bool(((value >= low - 1e-6) & (value <= high + 1e-6)).all())
    assert float(joints[:, JOINT_DOFS.index("index_pip_fe")].max()) > 1.2, "the whole range is used"
    assert bool((joints[:, JOINT_DOFS.index("index_cmc_fe")] == 0).all()), "no angle of the 27-DOF space"
    assert bool(found.keypoints.isfinite().all())
    identity = torch.eye(3).expand(200, 3, 3)
    torch.testing.assert_close(found.root_reference @ found.root_reference.mT, identity, atol=1e-5, rtol=0)
    torch.testing.assert_close(torch.linalg.det(found.root_reference), torch.ones(200))


def test_the_keypoints_are_those_of_the_pose(generator: torch.Generator) -> None:
    points = _points(generator, 2, 3)
    sides: tuple[Side, ...] = ("right", "left")
    for side in sides:
        found = estimate_hands(_network(), points, side=side)
        kinematics = MODEL.kinematics(side)
        frames = kinematics(found.pose, found.shape, root_reference=found.root_reference)
        torch.testing.assert_close(frames.keypoints, found.keypoints, atol=1e-6, rtol=0)
        torch.testing.assert_close(torch.linalg.det(found.root_reference), torch.ones(2, 3))
        state = MODEL.hand(side=side)(found.pose, found.shape, root_reference=found.root_reference)
        torch.testing.assert_close(state.keypoints, found.keypoints, atol=1e-6, rtol=0)


def test_a_left_hand_is_seen_in_the_mirror(generator: torch.Generator) -> None:
    points, across = _points(generator, 5), torch.tensor((-1.0, 1.0))
    right = estimate_hands(_network(), points)
    left = estimate_hands(_network(), points * across, side="left")
    torch.testing.assert_close(left.keypoints, right.keypoints * torch.tensor((-1.0, 1.0, 1.0)))
    torch.testing.assert_close(left.pose[:, 6:], right.pose[:, 6:])


def test_a_camera_turned_about_its_axis_turns_the_estimate(generator: torch.Generator) -> None:
    points = _points(generator, 4)
    roll = rotation_from_vector(torch.tensor((0.0, 0.0, 2.0)))
    one, other = (estimate_hands(_network(), some) for some in (points, points @ roll[:2, :2].T))
    torch.testing.assert_close(other.keypoints, one.keypoints @ roll.T, atol=1e-5, rtol=0)
    torch.testing.assert_close(other.root_reference, roll @ one.root_reference, atol=1e-5, rtol=0)
    torch.testing.assert_close(other.shape, one.shape, atol=1e-5, rtol=0)


def test_the_start_is_the_usual_hand_of_the_size_that_is_seen(generator: torch.Generator) -> None:
    network = _network(wild=0.0)
    points = _points(generator, 3)
    near, far = (estimate_hands(network, points * size) for size in (1.0, 0.25))
    distances = [found.keypoints.mean(1).norm(dim=-1) for found in (near, far)]
    torch.testing.assert_close(distances[1], 4 * distances[0], rtol=0.35, atol=0)
    usual = network.usual_keypoints()
    pose = torch.zeros(36)
    pose[6:] = 0.1
    for dof in ("index_cmc_fe", "thumb_cmc_tw", "index_mcp_tw"):
        pose[6 + JOINT_DOFS.index(dof)] = 0.0
    lengths = (usual[5:9].diff(dim=0).norm(dim=-1), MODEL.kinematics()(pose).keypoints[5:9].diff(dim=0).norm(dim=-1))
    torch.testing.assert_close(*lengths, atol=2e-4, rtol=0)


def test_gradients_reach_every_weight(generator: torch.Generator) -> None:
    network = _network()
    found = network(observe(_points(generator, 8), torch.ones(8, 21, dtype=torch.bool)))
    (found.keypoints.square().sum() + found.pose.sum()).backward()
    for name, parameter in network.named_parameters():
        assert parameter.grad is not None, name
        assert bool(parameter.grad.isfinite().all()), name
        assert float(parameter.grad.abs().max()) > 0, name


def test_hands_with_too_few_points_are_nan(generator: torch.Generator) -> None:
    points = _points(generator, 3)
    points[0, 5:] = torch.nan  # five are left
    seen = torch.ones(3, 21, dtype=torch.bool)
    seen[1, 6:] = False  # six
    found = estimate_hands(_network(), points, seen)
    for name in ("pose", "root_reference", "shape", "keypoints"):
        value = getattr(found, name).flatten(1)
        assert bool(value[0].isnan().all()), name
        assert bool(value[1:].isfinite().all()), name


@pytest.mark.parametrize("batch", [(), (1,), (2, 3)])
def test_batches_equal_a_loop(batch: tuple[int, ...], generator: torch.Generator) -> None:
    points, network = _points(generator, *batch), _network()
    whole = estimate_hands(network, points)
    loop = [estimate_hands(network, some).keypoints for some in points.reshape(-1, 21, 2)]
    torch.testing.assert_close(whole.keypoints.reshape(-1, 21, 3), torch.stack(loop), atol=1e-5, rtol=0)


def test_weights_can_be_loaded_into_another_network() -> None:
    network = _network()
    other = PoseNetwork(MODEL, torch.zeros(30), width=24, blocks=1)
    other.load_state_dict(network.state_dict())
    torch.testing.assert_close(other.usual_keypoints(), network.usual_keypoints())
    points = 0.1 * torch.randn(4, 21, 2, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(estimate_hands(other, points).pose, estimate_hands(network, points).pose)
