"""Hostile input of filters: motions, measurements with every kind of fault, beliefs that are hardly covariances."""

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.numerics import Gaussian, Measurement, MotionModel

DOFS, ROWS = 4, 10
STEPS_S = (1 / 120, 1 / 30, 0.2, 2.0)
_BLIND_BEYOND = 6.0  # the last measurement cannot be predicted where the first degree of freedom is above this
_GAP_BEGINS, _GAP_ENDS = 0.02, 0.1
_RESTARTS = 0.02


class Hostile:
    """What a batch of filters of one dtype goes through, seeded; it remembers the true states and the gaps."""

    def __init__(self, count: int, motion: MotionModel, dtype: torch.dtype, generator: torch.Generator) -> None:
        self.count, self.motion, self.dtype, self.generator = count, motion, dtype, generator
        self.size = motion.state_size(DOFS)
        self.mixing = self._normal(ROWS, DOFS)
        self.truth = self._normal(count, self.size)
        self.in_gap = torch.zeros(count, dtype=torch.bool)
        self.reach = math.log10(torch.finfo(dtype).max) - 1
        self.precision = -math.log10(torch.finfo(dtype).eps)
        """Decimal digits of the dtype."""

    def observe(self, states: Float[Tensor, "*batch states"]) -> Float[Tensor, "*batch rows"]:
        """What states, or their first DOFS numbers, look like; NaN where that cannot be told."""
        mixed = states[..., :DOFS] @ self.mixing.mT
        return torch.where(self._is_blind(states), torch.nan, mixed.sin() + 0.5 * mixed)

    def linearised(
        self, states: Float[Tensor, "*batch states"]
    ) -> tuple[Float[Tensor, "*batch rows"], Float[Tensor, "*batch rows dofs"]]:
        """`observe` with its derivative in the first DOFS numbers."""
        mixed = states[..., :DOFS] @ self.mixing.mT
        slopes = (mixed.cos() + 0.5)[..., None] * self.mixing
        return self.observe(states), torch.where(self._is_blind(states)[..., None], torch.nan, slopes)

    def swayed(self, states: Float[Tensor, "*batch states"], transition: Tensor) -> Float[Tensor, "*batch states"]:
        """A motion that is not linear: that of the model, less a hundredth of the states' sines."""
        return states @ transition.mT - 0.01 * states.sin()

    def begin(self) -> Gaussian:
        """A belief for every filter; covariances of any scale, most of them singular or nearly so."""
        count, size, digits = self.count, self.size, self.precision
        units = 10 ** self._between(-0.25 * digits, 0.15 * digits, count, size, 1)
        root = units * self._normal(count, size, size)
        kept = torch.arange(size) < torch.randint(1, size + 1, (count, 1), generator=self.generator)
        root = root * kept[:, None]  # of any rank
        root = torch.where(self._chance(0.1, count, 1, 1), root[..., :1].expand_as(root), root)  # one direction
        root = torch.where(self._chance(0.05, count, 1, 1), 0.0, root)  # known exactly
        tilt = 10 ** self._between(-1.5 * digits, -0.5 * digits, count, 1, 1)
        root = torch.where(self._chance(0.1, count, 1, 1), units * (1 + tilt * self._normal(count, size, size)), root)
        return Gaussian(self.truth + 0.1 * self._normal(count, self.size), root @ root.mT)

    def restarted(self, state: Gaussian, wrong: Bool[Tensor, "filters"]) -> Gaussian:
        """Some filters, and those that are wrong, begin anew."""
        again = self._chance(_RESTARTS, self.count) | wrong
        fresh = self.begin()
        return Gaussian(
            torch.where(again[:, None], fresh.mean, state.mean),
            torch.where(again[:, None, None], fresh.covariance, state.covariance),
        )

    def process_noise(self, dt_s: float) -> Float[Tensor, "filters states states"]:
        """Of very different strengths, or none at all."""
        density = 10 ** self._between(-6.0, 1.0, self.count, DOFS)
        return self.motion.process_noise(dt_s, torch.where(self._chance(0.1, self.count, 1), 0.0, density))

    def move(self, transition: Float[Tensor, "states states"]) -> None:
        """The true states move on; some jump."""
        moved = self.truth @ transition.mT
        jump = self._chance(0.01, self.count, 1) | ~(moved.abs() < 20).all(-1, keepdim=True)
        self.truth = torch.where(jump, self._normal(self.count, self.size), moved)

    def measure(self) -> Measurement:
        """Measurements with noise, outliers of every size, infinities, NaN, missing ones, and gaps of many frames."""
        shape = (self.count, ROWS)
        variance = 10 ** self._between(-1.2 * self.precision, 0.4 * self.precision, *shape)
        values = self.observe(self.truth) + variance.sqrt() * self._normal(*shape)
        outlier = self._normal(*shape) * 10 ** self._between(0.0, 4.0, *shape)
        wild = self._normal(*shape).sign() * 10 ** self._between(4.0, self.reach, *shape)
        for share, fault in (
            (0.05, outlier),
            (0.01, wild),
            (0.02, torch.nan),
            (0.01, torch.inf),
            (0.01, -torch.inf),
        ):
            values = torch.where(self._chance(share, *shape), fault, values)
        valid = ~self._chance(0.1, *shape)
        self.in_gap = torch.where(
            self.in_gap, ~self._chance(_GAP_ENDS, self.count), self._chance(_GAP_BEGINS, self.count)
        )
        valid = valid & ~self.in_gap[:, None]
        nonsense = torch.tensor([0.0, -1.0, torch.nan, torch.inf], dtype=self.dtype)
        nonsense = nonsense[torch.randint(4, shape, generator=self.generator)]
        return Measurement(values, torch.where(valid | self._chance(0.5, *shape), variance, nonsense), valid)

    def correlated(self, seen: Measurement) -> Float[Tensor, "filters rows rows"]:
        """The noise's variances with correlations, in some filters of one direction alone."""
        direction = self._normal(self.count, ROWS, 1)
        direction = direction / direction.norm(dim=-2, keepdim=True)
        own = torch.where(self._chance(0.2, self.count, 1, 1), 10.0**-self.precision, 1.0)
        correlation = direction @ direction.mT
        identity = torch.eye(ROWS, dtype=self.dtype)
        correlation = own * identity + correlation
        std = seen.noise.sqrt()
        return std[:, :, None] * correlation * std[:, None, :]

    def _is_blind(self, states: Tensor) -> Tensor:
        last = torch.arange(ROWS) == ROWS - 1
        return last & (states[..., :1] > _BLIND_BEYOND)

    def _normal(self, *shape: int) -> Tensor:
        return torch.randn(*shape, generator=self.generator, dtype=torch.float64).to(self.dtype)

    def _between(self, low: float, high: float, *shape: int) -> Tensor:
        fraction = torch.rand(*shape, generator=self.generator, dtype=torch.float64)
        return (low + (high - low) * fraction).to(self.dtype)

    def _chance(self, share: float, *shape: int) -> Tensor:
        return torch.rand(*shape, generator=self.generator) < share
