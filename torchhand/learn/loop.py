"""The loop of every training: a step of the optimiser after the other, along a learning rate, with reports."""

import math
from collections.abc import Callable, Iterator

import torch
from torch import Tensor, nn

Loss = Callable[[int], tuple[Tensor, Tensor]]
"""From a step's number to what the step descends and what is reported of it, nats or whatever the loss is in."""


def descend(
    network: nn.Module,
    optimiser: torch.optim.Optimizer,
    loss_at: Loss,
    *,
    steps: range,
    rate_at: Callable[[int], float],
    clipped: float,
    report_every: int,
) -> Iterator[tuple[int, float]]:
    """Do the steps of a range; after every `report_every` steps, counted from 0, and after the last, yield how many are
    done and the mean of what was to be reported since.

    `loss_at` draws what is random from the seed and the step's number, so that a training that is broken off and taken
    up again with its optimiser ends as one that was not. clipped: largest norm of the gradient.
    """
    told: list[Tensor] = []  # read when they are reported: whoever reads waits for the device
    for step in steps:
        for group in optimiser.param_groups:
            group["lr"] = rate_at(step)
        descended, reported = loss_at(step)
        optimiser.zero_grad()
        descended.backward()
        nn.utils.clip_grad_norm_(network.parameters(), clipped)
        optimiser.step()
        told.append(reported.detach())
        if (step + 1) % report_every == 0 or step + 1 == steps.stop:
            yield step + 1, sum(map(float, told)) / len(told)
            told = []


def warmed_cosine(fraction: float) -> float:
    """Share of the largest learning rate at a share of the steps: up over the first twentieth, then down to almost
    nothing along a cosine."""
    return min(20 * fraction, 0.5 * (1 + math.cos(math.pi * fraction)) + 1e-3)
