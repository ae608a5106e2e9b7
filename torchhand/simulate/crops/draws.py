"""Random numbers that are the same on any device."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.devices import HOST


@dataclass(frozen=True, kw_only=True)
class Draws:
    """Draws on the processor, and sends to a device."""

    generator: torch.Generator
    """Of the processor."""
    device: torch.device = HOST

    def uniform(self, *size: int) -> Float[Tensor, "..."]:
        """Numbers from 0 to 1."""
        return torch.rand(*size, generator=self.generator).to(self.device)

    def normal(self, *size: int) -> Float[Tensor, "..."]:
        """Numbers with mean 0 and standard deviation 1."""
        return torch.randn(*size, generator=self.generator).to(self.device)

    def whole(self, low: int, high: int, count: int) -> Int[Tensor, "count"]:
        """Whole numbers from `low` to `high` - 1."""
        return torch.randint(low, high, (count,), generator=self.generator).to(self.device)

    def places(self, count: int, ends: int) -> list[int]:
        """Whole numbers from 0 to `ends` - 1, which stay with the processor."""
        return torch.randint(ends, (count,), generator=self.generator).tolist()

    def between(self, ends: tuple[float, float], *size: int) -> Float[Tensor, "..."]:
        """Numbers between two."""
        low, high = ends
        return low + (high - low) * self.uniform(*size)
