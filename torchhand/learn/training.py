"""Training of the pose network on samples of the prior, step by step and resumable to the bit."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import reduce
from typing import Any, Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.utils._pytree import tree_map_only

from torchhand.devices import sent_to
from torchhand.hand import JOINT_DOFS, HandModel, HandPrior
from torchhand.learn.data import HandPool, Samples, SampleSettings, draw_samples, hand_pool
from torchhand.learn.loop import descend, warmed_cosine
from torchhand.learn.network import HandEstimate, PoseNetwork
from torchhand.learn.observation import observe

CPU = torch.device("cpu")
_NEAREST = 0.02  # metres: depth below which a keypoint is not projected


@dataclass(frozen=True, kw_only=True)
class LossWeights:
    """Factors of the terms of the loss."""

    keypoints: float = 1.0
    """Distance of the keypoints relative to the wrist, cm."""
    reprojection: float = 1.0
    """Weight of distances in the picture, as fractions of the hand's size there."""
    distance: float = 1.0
    """Logarithm of the ratio of the wrists' depths."""
    joints: float = 1.0
    """Mean absolute error of the joint angles, radians."""
    energy: float = 1e-3
    """Energy of the prior, nats."""


@runtime_checkable
class LossSettings(Protocol):
    """What of the settings of a training its loss depends on."""

    @property
    def weights(self) -> LossWeights: ...

    @property
    def energy_hands(self) -> int: ...


@dataclass(frozen=True, kw_only=True)
class TrainingSettings:
    """How the network is trained. The same settings give the same network on the same machine."""

    seed: int = 0
    """Seed of everything that is random."""
    steps: int = 4000
    """Steps of the optimiser."""
    batch: int = 256
    """Hands per step."""
    learning_rate: float = 3e-3
    """Largest step of Adam; it rises over the first twentieth and falls to zero as a cosine."""
    pool: int = 20_000
    """Hands drawn from the prior to train on; each is seen by many cameras."""
    held_out: int = 2000
    """Other hands, to measure on."""
    energy_hands: int = 32
    """Hands of each step whose energy is reckoned: it costs more than all the rest."""
    width: int = 256
    """Numbers in each layer."""
    blocks: int = 3
    """Residual blocks."""
    samples: SampleSettings = field(default_factory=SampleSettings)
    """Cameras and detectors."""
    weights: LossWeights = field(default_factory=LossWeights)

    def __post_init__(self) -> None:
        ranges = {
            "steps": (1, 10_000_000),
            "batch": (2, 100_000),
            "pool": (10, 10_000_000),
            "held_out": (10, 1_000_000),
        }
        ranges |= {"width": (8, 8192), "blocks": (0, 64), "energy_hands": (0, 100_000), "seed": (0, 2**62)}
        for name, (low, high) in ranges.items():
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name}: expected {low} to {high}, got {getattr(self, name)}")
        if not 0 < self.learning_rate <= 1:
            raise ValueError(f"learning_rate: expected above 0, at most 1, got {self.learning_rate}")


@dataclass(kw_only=True)
class Training:
    """A network on its way."""

    settings: TrainingSettings
    network: PoseNetwork
    optimiser: torch.optim.Adam
    step: int
    """Number of steps done."""
    loss: float
    """Mean over the steps since it was last read."""


@dataclass(frozen=True, kw_only=True)
class TrainingData:
    """What a training run draws from; follows from the settings alone."""

    pool: HandPool
    held_out: Samples
    prior: HandPrior
    """float32, for the loss."""


def training_data(settings: TrainingSettings, model: HandModel, device: torch.device = CPU) -> TrainingData:
    """Hands to train on and hands to measure on, which stay with the processor, and the prior on the device."""
    prior = HandPrior(model.skeleton, model.shape_space, dtype=torch.float64)
    generator = _generator(settings.seed, 0)
    pool = hand_pool(prior, model, settings.pool, generator)
    others = hand_pool(prior, model, settings.held_out, generator)
    held_out = draw_samples(others, torch.arange(settings.held_out), settings.samples, generator)
    light = HandPrior(model.skeleton, model.shape_space.to(dtype=torch.float32)).float()
    return TrainingData(pool=pool, held_out=held_out, prior=light.to(device))


def new_training(
    settings: TrainingSettings, model: HandModel, data: TrainingData, device: torch.device = CPU
) -> Training:
    """A network on the device with random weights, the same on any, at step 0; torch's own generator is left as it
    was."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(settings.seed)
        network = PoseNetwork(model, data.pool.joints.mean(0), width=settings.width, blocks=settings.blocks)
    network.to(device)
    optimiser = torch.optim.Adam(network.parameters(), lr=settings.learning_rate)
    return Training(settings=settings, network=network, optimiser=optimiser, step=0, loss=math.nan)


def train(training: Training, data: TrainingData, *, pause_every: int) -> Iterator[Training]:
    """Goes on to the last step; yields the same record, changed, after every `pause_every` steps and at the end.

    What is random in a step follows from the seed and the step's number, so a run that is broken off and taken up again
    ends as one that was not. Samples are drawn by the processor and sent to the network's device.
    """
    settings, device = training.settings, training.network.start.device

    def loss_at(step: int) -> tuple[Tensor, Tensor]:
        generator = _generator(settings.seed, step + 1)
        rows = torch.randint(len(data.pool), (settings.batch,), generator=generator)
        samples = sent_to(draw_samples(data.pool, rows, settings.samples, generator), device)
        estimate = training.network(observe(samples.points_plane, samples.seen))
        loss = reduce(torch.add, loss_terms(estimate, samples, data.prior, settings).values())
        return loss, loss

    steps = range(training.step, settings.steps)
    for step, loss in descend(
        training.network,
        training.optimiser,
        loss_at,
        steps=steps,
        rate_at=lambda step: learning_rate(settings, step),
        clipped=1.0,
        report_every=pause_every,
    ):
        training.step, training.loss = step, loss
        yield training


def loss_terms(
    estimate: HandEstimate, samples: Samples, prior: HandPrior, settings: LossSettings
) -> dict[str, Float[Tensor, ""]]:
    """The weighted terms of the loss by name, means over the hands."""
    weights, few = settings.weights, slice(settings.energy_hands)
    own, true = estimate.keypoints, samples.keypoints
    difference = (own - own[:, :1]) - (true - true[:, :1])
    picture, true_picture = (points[..., :2] / points[..., 2:].clamp_min(_NEAREST) for points in (own, true))
    spread = (true_picture - true_picture.mean(1, keepdim=True)).square().sum(-1).mean(1).sqrt()
    ratio = own[:, 0, 2].clamp_min(_NEAREST) / true[:, 0, 2]
    terms = {
        "keypoints": 100 * difference[:, 1:].norm(dim=-1).mean(),
        "reprojection": ((picture - true_picture).norm(dim=-1).mean(1) / spread).mean(),
        "distance": ratio.log().abs().mean(),
        "joints": (estimate.pose[:, -len(JOINT_DOFS) :] - samples.joints).abs().mean(),
    }
    if settings.energy_hands and weights.energy:
        terms["energy"] = prior.energy(estimate.pose[few], estimate.shape[few]).mean()
    return {name: getattr(weights, name) * term for name, term in terms.items()}


def learning_rate(settings: TrainingSettings, step: int) -> float:
    """Learning rate of one step: up over the first twentieth, then down to zero along a cosine."""
    return settings.learning_rate * warmed_cosine((step + 1) / settings.steps)


def snapshot(training: Training) -> dict[str, Any]:
    """What has to be kept to go on later, on any device."""
    return kept_state(training.step, training.network, training.optimiser)


def kept_state(step: int, network: nn.Module, optimiser: torch.optim.Optimizer) -> dict[str, Any]:
    """A training's step and the states of its network and optimiser, in the processor's memory."""
    states = {"network": network.state_dict(), "optimiser": optimiser.state_dict()}
    return {"step": step} | tree_map_only(Tensor, lambda tensor: tensor.cpu(), states)


def restored(training: Training, kept: dict[str, Any]) -> Training:
    """The training (as `new_training` made it) at the point where the snapshot was taken."""
    training.network.load_state_dict(kept["network"])
    training.optimiser.load_state_dict(kept["optimiser"])
    training.step = int(kept["step"])
    return training


def _generator(seed: int, step: int) -> torch.Generator:
    """Another one for every step: the numbers of neighbouring seeds are mixed by torch's own seeding."""
    return torch.Generator().manual_seed((seed * 1_000_003 + step * 2_654_435_761) % 2**62)
