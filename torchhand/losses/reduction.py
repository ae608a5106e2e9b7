"""From one loss per element of a batch to what a training loop wants."""

from typing import Literal

from torch import Tensor

Reduction = Literal["none", "mean", "sum"]
"""One loss per element of the batch, their mean, or their sum; as torch's losses have it."""


def reduced(losses: Tensor, reduction: Reduction) -> Tensor:
    """The losses as `reduction` asks. Raises ValueError for another word."""
    if reduction == "none":
        return losses
    if reduction == "mean":
        return losses.mean()
    if reduction == "sum":
        return losses.sum()
    raise ValueError(f"reduction: expected 'none', 'mean' or 'sum', got {reduction!r}")
