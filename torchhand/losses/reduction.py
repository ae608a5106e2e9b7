"""From one loss per element of a batch to what a training loop wants."""

from typing import Literal, get_args

from torch import Tensor

Reduction = Literal["none", "mean", "sum"]
"""One loss per element of the batch, their mean, or their sum; as torch's losses have it."""


def reduced(losses: Tensor, reduction: Reduction) -> Tensor:
    """The losses as `reduction` asks. Raises ValueError for another word."""
    if reduction not in get_args(Reduction):
        raise ValueError(f"reduction: expected 'none', 'mean' or 'sum', got {reduction!r}")
    return losses if reduction == "none" else losses.mean() if reduction == "mean" else losses.sum()
