"""The network's heads: rotations, angles within their limits, weights that add up; views do not touch each other."""

import pytest
import torch

from torchhand.files import load_hand_model
from torchhand.hand import JOINT_DOFS
from torchhand.propose.channels import CHANNELS
from torchhand.propose.network import ProposalNetwork
from torchhand.propose.views import SIDE_PX

SKELETON = load_hand_model().skeleton


def _network(*, wild: float = 1.0) -> ProposalNetwork:
    """Random weights, the last layer's many times what they are at the start."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(1)
        network = ProposalNetwork(SKELETON, hypotheses=5, width=4, hidden=16)
    with torch.no_grad():
        network.heads.weight *= wild
    return network.eval()


def _views(generator: torch.Generator, count: int) -> torch.Tensor:
    return torch.randn(count, CHANNELS, SIDE_PX, SIDE_PX, generator=generator)


@pytest.mark.parametrize("wild", [1.0, 300.0])
def test_hypotheses_are_hands(wild: float, generator: torch.Generator) -> None:
    with torch.no_grad():
        found = _network(wild=wild)(_views(generator, 6))
    assert bool((found.joints >= SKELETON.lower - 1e-6).all())
    assert bool((found.joints <= SKELETON.upper + 1e-6).all())
    turn = found.rotation
    torch.testing.assert_close(turn @ turn.mT, torch.eye(3).expand(6, 5, 3, 3), atol=1e-5, rtol=0)
    torch.testing.assert_close(torch.linalg.det(turn), torch.ones(6, 5), atol=1e-5, rtol=0)
    torch.testing.assert_close(found.log_weight.exp().sum(-1), torch.ones(6))
    assert bool((found.spread > 0).all())


def test_joints_outside_the_27_degrees_of_freedom_do_not_move(generator: torch.Generator) -> None:
    with torch.no_grad():
        found = _network(wild=30.0)(_views(generator, 4))
    still = [i for i, name in enumerate(JOINT_DOFS) if name.endswith("_tw")]
    moving = [i for i, name in enumerate(JOINT_DOFS) if name.endswith(("pip_fe", "dip_fe", "mcp_aa"))]
    assert bool((found.joints[..., still] == 0).all())
    assert bool((found.joints[..., moving].std((0, 1)) > 0.01).all())


def test_views_are_seen_one_by_one(generator: torch.Generator) -> None:
    network, views = _network(), _views(generator, 3)
    with torch.no_grad():
        whole, loop = network(views), [network(one[None]) for one in views]
    for name in ("rotation", "joints", "place", "log_size", "spread", "log_weight"):
        alone = torch.cat([getattr(one, name) for one in loop])
        torch.testing.assert_close(getattr(whole, name), alone, atol=1e-5, rtol=0)


@pytest.mark.parametrize("name", ["hypotheses", "width", "hidden"])
def test_sizes_that_make_no_network_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match=f"{name}: expected 1 to 4096, got 0"):
        ProposalNetwork(SKELETON, **{name: 0})
