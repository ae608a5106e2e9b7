"""Training of the proposal network on rendered hands; everything random follows from the seed and the step's number."""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.devices import sent_to
from torchhand.errors import require
from torchhand.geometry import rotation_of_quaternion
from torchhand.hand import HandKinematics, HandModel
from torchhand.learn import descend, warmed_cosine
from torchhand.learn.proposals.observing import SeenHands, seen_hands
from torchhand.learn.proposals.rendering import RenderedHands
from torchhand.propose import ProposalNetwork, ViewedHands, palm_middle

_WARM_UP = 0.1  # share of the steps in which all hypotheses are drawn to the truth, so that none is left behind
_DM_PER_M = 10.0
_JOINT_WEIGHT, _PLACE_WEIGHT, _SIZE_WEIGHT = 0.15, 1.0, 0.5  # dm for a radian, for half the square, for a factor e
_INDEPENDENT = 10.0  # errors that a hand has: keypoints move together
_WEIGHT_DECAY = 1e-3
_CLIPPED = 5.0  # norm of the gradient


@dataclass(frozen=True, kw_only=True)
class ProposalTraining:
    """How the network is trained."""

    seed: int = 0
    steps: int = 9000
    batch: int = 64
    """Views per step."""
    learning_rate: float = 2e-3
    """Largest step of AdamW; it rises over the first twentieth and falls to zero as a cosine."""
    hands: int = 80_000
    """Rendered hands to train on; each is seen in many views."""
    held_out: int = 3000
    """Other hands, to measure on."""
    hypotheses: int = 8
    width: int = 16
    """Channels after the first convolution; they double at each of the next three."""

    def __post_init__(self) -> None:
        ranges = {"seed": (0, 2**62), "steps": (1, 10_000_000), "batch": (2, 100_000), "hands": (8, 10_000_000)}
        ranges |= {"held_out": (2, 1_000_000), "hypotheses": (1, 64), "width": (1, 256)}
        for name, (low, high) in ranges.items():
            require(low <= getattr(self, name) <= high, name, f"{low} to {high}", getattr(self, name))
        require(0 < self.learning_rate <= 1, "learning_rate", "above 0, at most 1", self.learning_rate)


@dataclass(frozen=True, kw_only=True)
class Progress:
    """Where a training stands."""

    step: int
    loss: float
    """Mean since the last report, nats."""
    network: ProposalNetwork


def new_network(settings: ProposalTraining, model: HandModel) -> ProposalNetwork:
    """A network whose hypotheses begin with unlike directions; torch's own generator is left as it was."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(settings.seed)
        network = ProposalNetwork(model.skeleton, hypotheses=settings.hypotheses, width=settings.width)
        turns = rotation_of_quaternion(torch.randn(settings.hypotheses, 4))
        bias = network.heads.bias.detach().unflatten(0, (settings.hypotheses, -1))
        bias[:, :6] = turns.mT[:, :2].flatten(1)
    return network


def train_proposals(
    network: ProposalNetwork,
    hands: RenderedHands,
    settings: ProposalTraining,
    model: HandModel,
    *,
    report_every: int,
) -> Iterator[Progress]:
    """Trains to the last step; reports after every `report_every` steps and at the end. The network is changed.

    Views are made by the processor and sent to the network's device.
    """
    device = network.heads.weight.device
    kinematics = model.kinematics(dtype=torch.float32).to(device)
    optimiser = torch.optim.AdamW(network.parameters(), lr=settings.learning_rate, weight_decay=_WEIGHT_DECAY)
    network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def loss_at(step: int) -> tuple[Tensor, Tensor]:
        generator = generator_of(settings.seed, step + 1)
        rows = torch.randint(len(hands), (settings.batch,), generator=generator)
        seen = sent_to(seen_hands(hands.rows(rows), generator), device)
        network.train()
        found = network(seen.channels)
        errors = hypothesis_errors(found, seen, kinematics)
        loss = mixture_loss(found, errors)
        return loss + 2 * max(0.0, 1 - (step + 1) / settings.steps / _WARM_UP) * errors.mean(), loss

    for step, loss in descend(
        network,
        optimiser,
        loss_at,
        steps=range(settings.steps),
        rate_at=lambda step: settings.learning_rate * warmed_cosine((step + 1) / settings.steps),
        clipped=_CLIPPED,
        report_every=report_every,
    ):
        yield Progress(step=step, loss=loss, network=network.eval())


def hypothesis_errors(found: ViewedHands, seen: SeenHands, kinematics: HandKinematics) -> Float[Tensor, "hands k"]:
    """How far each hypothesis is from the truth: mean distance of the keypoints about the palm's middle, dm, and what
    angles, place and size are off, in proportion to it. Both hands have the same proportions."""
    own = keypoints_about_palm(kinematics, found.rotation, found.joints)
    true = keypoints_about_palm(kinematics, seen.rotation, seen.joints)
    error = _DM_PER_M * (own - true[:, None]).norm(dim=-1).mean(-1)
    error = error + _JOINT_WEIGHT * (found.joints - seen.joints[:, None]).abs().mean(-1)
    error = error + _PLACE_WEIGHT * (found.place - seen.place[:, None]).norm(dim=-1)
    return error + _SIZE_WEIGHT * (found.log_size - seen.log_size[:, None]).abs()


def mixture_loss(found: ViewedHands, errors: Float[Tensor, "hands k"]) -> Float[Tensor, ""]:
    """Negative log-likelihood of a mixture whose components fall off exponentially with their errors (Bishop 1994)."""
    fit = -_INDEPENDENT * (errors / found.spread + found.spread.log())
    return -torch.logsumexp(found.log_weight + fit, -1).mean()


def keypoints_about_palm(
    kinematics: HandKinematics, rotation: Float[Tensor, "*batch 3 3"], joints: Float[Tensor, "*batch 30"]
) -> Float[Tensor, "*batch 21 3"]:
    """Keypoints of the usual hand relative to the middle of its palm, metres."""
    pose = torch.cat((joints.new_zeros(*joints.shape[:-1], 6), joints), -1)
    points = kinematics(pose, root_reference=rotation).keypoints
    return points - palm_middle(points)[..., None, :]


def generator_of(seed: int, number: int) -> torch.Generator:
    """Another one for every number: those of neighbouring ones are mixed by torch's own seeding."""
    return torch.Generator().manual_seed((seed * 1_000_003 + number * 2_654_435_761) % 2**62)
