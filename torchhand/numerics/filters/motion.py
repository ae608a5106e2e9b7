"""How a state moves between two frames: random walk, constant velocity or constant acceleration, with noise."""

import functools
import math
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.precision import full_precision


@dataclass(frozen=True, kw_only=True)
class MotionModel:
    """Linear dynamics, the same for every degree of freedom (DOF).

    The state of k DOFs is laid out in blocks, [k positions, k velocities, k accelerations] (Stenger et al. 2001, eq.
    10), cut after the block `order`. In continuous time

        position' = velocity,  velocity' = acceleration - velocity / velocity_decay_s,
        acceleration' = noise - acceleration / acceleration_decay_s,

    with the noise driving the last block. Decay keeps a prediction over missing frames from running away; decay of the
    acceleration alone is Singer's model.
    """

    order: Literal[0, 1, 2] = 2
    """0 random walk, 1 constant velocity, 2 constant acceleration"""
    noise: Literal["white", "piecewise"] = "white"
    """white in continuous time, or one draw per step"""
    velocity_decay_s: float | None = None
    """Seconds until a velocity has fallen to 37 %; None: never. Ignored at order 0, which has no velocity."""
    acceleration_decay_s: float | None = None
    """Seconds until an acceleration has fallen to 37 %; None: never. Ignored below order 2, which has no
    acceleration."""

    def __post_init__(self) -> None:
        if self.order not in (0, 1, 2):
            raise ValueError(f"order must be 0, 1 or 2, got {self.order!r}")
        if self.noise not in ("white", "piecewise"):
            raise ValueError(f"noise must be 'white' or 'piecewise', got {self.noise!r}")
        for name in ("velocity_decay_s", "acceleration_decay_s"):
            decay_s = getattr(self, name)
            if decay_s is not None and not decay_s > 0:
                raise ValueError(f"{name} must be None or above 0 s, got {decay_s!r}")

    def state_size(self, dofs: int) -> int:
        """Length n = (order + 1) k of the state of k DOFs."""
        return (self.order + 1) * dofs

    def transition(
        self, dt_s: float, dofs: int, *, dtype: torch.dtype = torch.float64, device: torch.device | str = "cpu"
    ) -> Float[Tensor, "n n"]:
        """The matrix F that a step of `dt_s` seconds multiplies the expected state by."""
        block = _step(self, float(dt_s))[0].to(dtype=dtype, device=device)
        return torch.kron(block, torch.eye(dofs, dtype=dtype, device=device))

    @full_precision
    def process_noise(self, dt_s: float, density: Float[Tensor, "*batch k"]) -> Float[Tensor, "*batch n n"]:
        """Covariance Q that a step of `dt_s` seconds adds, for one density per DOF, all >= 0.

        "white": `density` is the spectral density of the driving noise, in (position unit)² / s^(2 order + 1), and two
        half steps add what one whole step does. "piecewise": `density` is the variance of one draw per step: of a
        velocity (order 0) or acceleration (order 1) that holds during the step, of a jump of the acceleration at its
        start (order 2).
        """
        block = _step(self, float(dt_s))[1].to(density)
        size = self.state_size(density.shape[-1])
        blocks = block[:, None, :, None] * density.diag_embed()[..., None, :, None, :]
        return blocks.reshape(*density.shape[:-1], size, size)


@functools.lru_cache(maxsize=256)
def _step(model: MotionModel, dt_s: float) -> tuple[Tensor, Tensor]:
    """F and Q of one DOF with density 1, (order + 1) square, float64."""
    if not (dt_s > 0 and math.isfinite(dt_s)):
        raise ValueError(f"dt_s must be finite and above 0 s, got {dt_s!r}")
    size = model.order + 1
    decays_s = [None, model.velocity_decay_s, model.acceleration_decay_s][:size]
    rates = [0.0 if decay_s is None else dt_s / decay_s for decay_s in decays_s]
    # Time in steps and derivative i in units of dt^i keep every number near 1, whatever the frame rate.
    transition, white = _unit_step(torch.tensor(rates, dtype=torch.float64))
    powers = torch.tensor([dt_s**i for i in range(size)], dtype=torch.float64)
    if model.noise == "white":
        noise = white * dt_s ** (2 * model.order + 1) / torch.outer(powers, powers)
    else:
        gain = transition[:, -1] if model.order == 2 else _held_input(rates) * dt_s
        gain = gain * dt_s**model.order / powers
        noise = torch.outer(gain, gain)
    return (transition * powers / powers[:, None]).contiguous(), noise


def _drift(rates: Tensor) -> Tensor:
    """Drift of one DOF over one unit of time: each block feeds the one before it and decays at its own rate."""
    size = len(rates)
    return torch.diag(torch.ones(size - 1, dtype=torch.float64), 1) - torch.diag(rates)


def _unit_step(rates: Tensor) -> tuple[Tensor, Tensor]:
    """F and white-noise Q of a step of one unit, by Van Loan's exponential and, where decay is fast, by doubling."""
    size = len(rates)
    doublings = max(0, math.ceil(math.log2(max(float(rates.max()), 1.0))))
    length = 0.5**doublings
    drift = _drift(rates)
    block = torch.zeros(2 * size, 2 * size, dtype=torch.float64)
    block[:size, :size] = -drift
    block[size - 1, 2 * size - 1] = 1.0
    block[size:, size:] = drift.mT
    exponential = torch.linalg.matrix_exp(block * length)
    transition = exponential[size:, size:].mT
    noise = transition @ exponential[:size, size:]
    for _ in range(doublings):
        noise = transition @ noise @ transition.mT + noise
        transition = transition @ transition
    return transition, 0.5 * (noise + noise.mT)


def _held_input(rates: list[float]) -> Tensor:
    """Effect, after one unit of time, of a constant input of 1 into the last block."""
    return torch.linalg.matrix_exp(_drift(torch.tensor([*rates, 0.0], dtype=torch.float64)))[:-1, -1]
