"""Perturbed starts: poses of a pose space that are off by known amounts, and what may be expected of such a start."""

import hashlib
import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.hand import PoseSpace

_TRANSLATIONS, _ROTATIONS = ("root_tx", "root_ty", "root_tz"), ("root_rx", "root_ry", "root_rz")
_MIN_STD = 1e-4  # metres or radians: of what is not perturbed at all


@dataclass(frozen=True, kw_only=True)
class PerturbationSettings:
    """How far starts are off at most; smaller sizes are shares of all three."""

    angle_deg: float = 15.0
    """Every free joint angle, either way, uniform; 0 to 180."""
    translation_mm: float = 10.0
    """Every free coordinate of the wrist, either way, uniform; 0 to 1000."""
    rotation_deg: float = 15.0
    """Turn of the hand about the wrist, uniform, about an axis of any direction; 0 to 180."""
    levels: int = 5
    """Sizes that are studied: the largest divided by so many, twice that, and so on to the largest; 1 to 100."""

    def __post_init__(self) -> None:
        for name, maximum in (("angle_deg", 180), ("translation_mm", 1000), ("rotation_deg", 180)):
            if not 0 <= getattr(self, name) <= maximum:
                raise ValueError(f"perturbation.{name}: expected 0 to {maximum}, got {getattr(self, name)!r}")
        if not 1 <= self.levels <= 100:
            raise ValueError(f"perturbation.levels: expected 1 to 100, got {self.levels!r}")
        if self.angle_deg == self.translation_mm == self.rotation_deg == 0:
            raise ValueError(
                "perturbation: expected angle_deg, translation_mm or rotation_deg above 0, got three zeros"
            )


def draw_perturbations(
    space: PoseSpace, size: Float[Tensor, "starts"], settings: PerturbationSettings, generator: torch.Generator
) -> Float[Tensor, "starts free"]:
    """Changes of the free parameters, metres and radians; the rotation is a left perturbation of the root.

    size: of every start, as a share of the largest. A larger size with the same generator scales the same changes.
    """
    translation, rotation, angle = _kinds(space)
    uniform = 2 * torch.rand(len(size), space.size, generator=generator, dtype=torch.float64) - 1
    axis = torch.randn(len(size), len(rotation), generator=generator, dtype=torch.float64)
    turn = 2 * torch.rand(len(size), 1, generator=generator, dtype=torch.float64) - 1
    change = torch.zeros_like(uniform)
    change[:, translation] = 1e-3 * settings.translation_mm * uniform[:, translation]
    change[:, angle] = math.radians(settings.angle_deg) * uniform[:, angle]
    direction = torch.nn.functional.normalize(axis, dim=-1)
    change[:, rotation] = math.radians(settings.rotation_deg) * turn * direction
    return size[:, None] * change


def spread_of_starts(space: PoseSpace, settings: PerturbationSettings) -> Float[Tensor, "free"]:
    """Standard deviations of the largest perturbation's free parameters, metres and radians."""
    translation, rotation, angle = _kinds(space)
    std = torch.zeros(space.size, dtype=torch.float64)
    std[translation] = 1e-3 * settings.translation_mm / math.sqrt(3)
    std[angle] = math.radians(settings.angle_deg) / math.sqrt(3)
    std[rotation] = math.radians(settings.rotation_deg) / math.sqrt(3 * max(1, len(rotation)))
    return std.clamp_min(_MIN_STD)


def seed_of(*parts: object) -> int:
    """A seed of 63 bits that differs wherever the parts, written out, do; the same on every machine."""
    digest = hashlib.sha256("/".join(map(str, parts)).encode()).digest()
    return int.from_bytes(digest[:8], "little") >> 1


def _kinds(space: PoseSpace) -> tuple[list[int], list[int], list[int]]:
    """Places of translations, rotations and angles among the free parameters."""
    names = space.free_names
    translation = [i for i, name in enumerate(names) if name in _TRANSLATIONS]
    rotation = [i for i, name in enumerate(names) if name in _ROTATIONS]
    return translation, rotation, [i for i in range(len(names)) if i not in (*translation, *rotation)]
