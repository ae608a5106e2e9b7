"""Training of the presence network: hands of the simulator against things of it, seen alike."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from torchhand.errors import require
from torchhand.learn import descend, warmed_cosine
from torchhand.learn.presence.things import RenderedThings
from torchhand.learn.proposals import RenderedHands, generator_of, observed_channels, seen_hands
from torchhand.propose import SIDE_PX, PresenceNetwork

_WEIGHT_DECAY = 1e-3
_WIDE = 0.1  # share of the hands that the view does not hold upright: it is about one that was registered
_AT_ONCE = 256
_CLIPPED = 5.0  # norm of the gradient
_SIZES = (0.6, 1.35)  # of a view's half side, over half the box about the thing
_SHIFT = 0.3  # of the view's middle, over half that box: largest


@dataclass(frozen=True, kw_only=True)
class PresenceTraining:
    """How the network is trained."""

    seed: int = 0
    steps: int = 4000
    batch: int = 64
    """Views of hands, and as many of things, per step."""
    learning_rate: float = 2e-3
    """Largest step of AdamW; it rises over the first twentieth and falls to zero as a cosine."""
    hands: int = 10_000
    """Rendered hands to train on, and as many things; each is seen in many views."""
    held_out: int = 1000
    """Other hands and things, to measure on."""
    width: int = 12
    """Channels after the first convolution; they double at each of the next three."""

    def __post_init__(self) -> None:
        ranges = {"seed": (0, 2**62), "steps": (1, 10_000_000), "batch": (1, 100_000), "hands": (8, 10_000_000)}
        ranges |= {"held_out": (2, 1_000_000), "width": (1, 256)}
        for name, (low, high) in ranges.items():
            require(low <= getattr(self, name) <= high, name, f"{low} to {high}", getattr(self, name))
        require(0 < self.learning_rate <= 1, "learning_rate", "above 0, at most 1", self.learning_rate)


def new_presence_network(settings: PresenceTraining) -> PresenceNetwork:
    """A network to train; torch's own generator is left as it was."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(settings.seed)
        return PresenceNetwork(width=settings.width)


def train_presence(
    network: PresenceNetwork,
    hands: RenderedHands,
    things: RenderedThings,
    settings: PresenceTraining,
    *,
    report_every: int,
) -> Iterator[tuple[int, float]]:
    """Trains to the last step; tells the step and the mean loss (nats) since the last report after every
    `report_every` steps and at the end. The network is changed.

    Views are made by the processor and sent to the network's device.
    """
    device = next(network.parameters()).device
    optimiser = torch.optim.AdamW(network.parameters(), lr=settings.learning_rate, weight_decay=_WEIGHT_DECAY)
    network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def loss_at(step: int) -> tuple[Tensor, Tensor]:
        channels, is_hand = seen_either(hands, things, settings.batch, generator_of(settings.seed, step + 1))
        network.train()
        told = network(channels.to(device))
        loss = nn.functional.binary_cross_entropy_with_logits(told, is_hand.to(told))
        return loss, loss

    for step, loss in descend(
        network,
        optimiser,
        loss_at,
        steps=range(settings.steps),
        rate_at=lambda step: settings.learning_rate * warmed_cosine((step + 1) / settings.steps),
        clipped=_CLIPPED,
        report_every=report_every,
    ):
        network.eval()
        yield step, loss


def seen_either(
    hands: RenderedHands, things: RenderedThings, count: int, generator: torch.Generator
) -> tuple[Float[Tensor, "two_count channels side side"], Bool[Tensor, "two_count"]]:
    """Views of random hands, then of as many random things, and which are hands."""
    rows = torch.randint(len(hands), (count,), generator=generator)
    seen = seen_hands(hands.rows(rows), generator, wide=_WIDE).channels
    other = seen_things(things.rows(torch.randint(len(things), (count,), generator=generator)), generator)
    is_hand = torch.arange(2 * count) < count
    return torch.cat((seen, other)), is_hand


def seen_things(things: RenderedThings, generator: torch.Generator) -> Float[Tensor, "things channels side side"]:
    """Each thing in a random view, with the errors of a random segmentation under random lights."""
    count, visible = len(things), things.label > 0
    centre, half = _boxes(visible)
    steps = (2 * torch.arange(SIDE_PX) + 1) / SIDE_PX - 1
    roll = 2 * math.pi * torch.rand(count, 1, 1, generator=generator)
    size = _SIZES[0] + (_SIZES[1] - _SIZES[0]) * torch.rand(count, generator=generator)
    shift = _SHIFT * (2 * torch.rand(count, 2, generator=generator) - 1)
    middle, reach = (centre + shift * half[:, None])[..., None, None], (size * half)[:, None, None]
    x = reach * (roll.cos() * steps - roll.sin() * steps[:, None]) + middle[:, 0]
    y = reach * (roll.sin() * steps + roll.cos() * steps[:, None]) + middle[:, 1]
    grid = torch.stack((x, y), -1)
    return observed_channels(visible, things.depth, things.normal, grid, generator, albedo=things.brightness)


def _boxes(masks: Bool[Tensor, "n side side"]) -> tuple[Float[Tensor, "n 2"], Float[Tensor, "n"]]:
    """Middles (x, y) and half the longer sides of the boxes around masks, -1 to 1 across the picture; all of it for an
    empty mask."""
    side = masks.shape[-1]
    ends = []
    for across in (masks.any(1), masks.any(2)):  # columns, rows
        first = torch.where(across.any(1), across.int().argmax(1), 0)
        last = torch.where(across.any(1), side - across.flip(1).int().argmax(1), side)
        ends.append(torch.stack((first, last), -1) * (2 / side) - 1)
    x, y = ends
    middle = torch.stack((x.mean(-1), y.mean(-1)), -1)
    return middle, 0.5 * torch.maximum(x[:, 1] - x[:, 0], y[:, 1] - y[:, 0])


def presence_figures(
    network: PresenceNetwork,
    hands: RenderedHands,
    things: RenderedThings,
    generator: torch.Generator,
    thresholds: tuple[float, ...] = (0.0, 2.0, 4.0, 6.0),
) -> dict[float, tuple[float, float]]:
    """For each threshold of the network's logarithm the share of hands below it, and of things above it, each in one
    random view."""
    device = next(network.parameters()).device
    with torch.no_grad():
        told = [
            torch.cat([network(views.to(device)) for views in channels.split(_AT_ONCE)])
            for channels in (seen_hands(hands, generator, wide=_WIDE).channels, seen_things(things, generator))
        ]
    own, other = told
    return {at: (float((own < at).float().mean()), float((other >= at).float().mean())) for at in thresholds}
