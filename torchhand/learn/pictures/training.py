"""Training from pictures: on crops of the simulator, then on these and on crops of a recording that nobody labelled."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import reduce
from typing import Any

import torch
from torch import Tensor

from torchhand.devices import sent_to
from torchhand.errors import require
from torchhand.hand import HandModel, HandPrior
from torchhand.learn import LossWeights, descend, loss_terms, warmed_cosine
from torchhand.learn.pictures.network import PictureNetwork
from torchhand.learn.pictures.recorded import RecordedCrops
from torchhand.learn.pictures.simulated import SimulatedCrops, simulated_crops
from torchhand.learn.pictures.teaching import Teacher, TeachingWeights, part

CPU = torch.device("cpu")
_CLIPPED = 2.0  # norm of the gradient


@dataclass(frozen=True, kw_only=True)
class PictureTraining:
    """How a network from pictures is trained. The same settings give the same network on the same machine."""

    seed: int = 0
    """Seed of everything that is random."""
    steps: int = 4000
    """Steps on crops of the simulator alone."""
    recorded_steps: int = 400
    """Steps on crops of the simulator and of a recording, after those; 0 without a recording."""
    batch: int = 64
    """Crops of the simulator per step."""
    recorded_batch: int = 16
    """Crops of the recording per step."""
    learning_rate: float = 2e-3
    """Largest step of Adam; it rises over the first twentieth and falls to zero as a cosine."""
    recorded_rate: float = 6e-4
    """The same of the steps with a recording."""
    pool: int = 20_000
    """Simulated crops to train on."""
    held_out: int = 800
    """Other ones, to measure on."""
    views: int = 4
    """Crops of each frame of the recording, cut anew around the hand."""
    width: int = 12
    """Channels after the first convolution; they double at each of the next three."""
    hidden: int = 256
    """Numbers in each layer after the convolutions."""
    blocks: int = 2
    """Residual blocks of these layers."""
    energy_hands: int = 8
    """Hands of each step whose energy is reckoned."""
    weights: LossWeights = field(default_factory=LossWeights)
    teaching: TeachingWeights = field(default_factory=TeachingWeights)

    def __post_init__(self) -> None:
        ranges = {"seed": (0, 2**62), "steps": (1, 10_000_000), "recorded_steps": (0, 10_000_000)}
        ranges |= {"batch": (2, 100_000), "recorded_batch": (1, 100_000), "pool": (8, 10_000_000), "views": (1, 64)}
        ranges |= {"held_out": (8, 1_000_000), "width": (1, 256), "hidden": (8, 8192), "blocks": (0, 64)}
        for name, (low, high) in ranges.items():
            require(low <= getattr(self, name) <= high, name, f"{low} to {high}", getattr(self, name))
        for name in ("learning_rate", "recorded_rate"):
            require(0 < getattr(self, name) <= 1, name, "above 0, at most 1", getattr(self, name))


@dataclass(frozen=True, kw_only=True)
class PictureData:
    """What a training draws from."""

    simulated: SimulatedCrops
    recorded: RecordedCrops | None
    prior: HandPrior
    teacher: Teacher


@dataclass(kw_only=True)
class PictureProgress:
    """A network on its way."""

    settings: PictureTraining
    network: PictureNetwork
    optimiser: torch.optim.Adam
    step: int
    """Number of steps done."""
    loss: float
    """Mean over the steps since it was last read."""


def new_picture_training(
    settings: PictureTraining, model: HandModel, usual_joints: Tensor, device: torch.device = CPU
) -> PictureProgress:
    """A network on the device with random weights, the same on any, at step 0; torch's own generator is left as it
    was."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(settings.seed)
        sizes = {"width": settings.width, "hidden": settings.hidden, "blocks": settings.blocks}
        network = PictureNetwork(model, usual_joints, **sizes)
    network.to(device)
    network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    optimiser = torch.optim.Adam(network.parameters(), lr=settings.learning_rate)
    return PictureProgress(settings=settings, network=network, optimiser=optimiser, step=0, loss=float("nan"))


def picture_data(
    settings: PictureTraining,
    model: HandModel,
    simulated: SimulatedCrops,
    recorded: RecordedCrops | None,
    device: torch.device = CPU,
) -> PictureData:
    """Everything that a step needs: all but the simulated crops on the device."""
    prior = HandPrior(model.skeleton, model.shape_space.to(dtype=torch.float32)).float()
    recorded = sent_to(recorded, device) if recorded is not None and settings.recorded_steps else None
    teacher = Teacher(model.to(device=device))
    return PictureData(simulated=simulated, recorded=recorded, prior=prior.to(device), teacher=teacher)


def train_from_pictures(training: PictureProgress, data: PictureData, *, pause_every: int) -> Iterator[PictureProgress]:
    """Goes on to the last step; yields the same record, changed, after every `pause_every` steps, at the end of the
    steps on the simulator alone, and at the end.

    What is random in a step follows from the seed and the step's number, so a run that is broken off and taken up again
    ends as one that was not.
    """
    settings, network = training.settings, training.network
    extra = settings.recorded_steps if data.recorded is not None else 0
    for first, count, rate in (
        (0, settings.steps, settings.learning_rate),
        (settings.steps, extra, settings.recorded_rate),
    ):
        for step, loss in descend(
            network,
            training.optimiser,
            lambda step: _loss(training, data, step),
            steps=range(max(first, training.step), first + count),
            rate_at=lambda step, first=first, count=count, rate=rate: rate * warmed_cosine((step - first + 1) / count),
            clipped=_CLIPPED,
            report_every=pause_every,
        ):
            training.step, training.loss = step, loss
            network.eval()
            yield training


def _loss(training: PictureProgress, data: PictureData, step: int) -> tuple[Tensor, Tensor]:
    """The loss on simulated crops, and from the end of the steps on these alone that on recorded ones as well."""
    settings, crops, device = training.settings, data.simulated, training.network.hands.start.device
    generator = step_generator(settings.seed, step + 1)
    rows = torch.randint(len(crops), (settings.batch,), generator=generator)
    images, intrinsics = crops.image[rows].to(device), crops.intrinsics[rows].to(device)
    truth = sent_to(crops.samples(rows), device)
    training.network.train()
    recorded = data.recorded if step >= settings.steps else None
    if recorded is None:
        estimate = training.network(images, intrinsics)
        loss = reduce(torch.add, loss_terms(estimate, truth, data.prior, settings).values())
        return loss, loss
    others = torch.randint(len(recorded), (settings.recorded_batch,), generator=generator).to(device)
    both = torch.cat((images, recorded.image[others])), torch.cat((intrinsics, recorded.intrinsics[others]))
    estimate = training.network(*both)
    own, taught = part(estimate, slice(len(rows))), part(estimate, slice(len(rows), None))
    loss = reduce(torch.add, loss_terms(own, truth, data.prior, settings).values())
    loss = loss + data.teacher.loss(taught, recorded, others, settings.teaching, settings.energy_hands)
    return loss, loss


def step_generator(seed: int, number: int) -> torch.Generator:
    """Another one for every number; those of negative numbers draw data."""
    return torch.Generator().manual_seed((seed * 1_000_003 + number * 2_654_435_761) % 2**62)


def simulated_data(
    settings: PictureTraining, model: HandModel, tick: Any = lambda count: None
) -> tuple[SimulatedCrops, SimulatedCrops]:
    """Crops to train on, and crops to measure on."""
    own = simulated_crops(model, settings.pool, step_generator(settings.seed, -1), tick)
    return own, simulated_crops(model, settings.held_out, step_generator(settings.seed, -2), tick)
