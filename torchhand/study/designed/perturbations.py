"""How far starts are off: distributions of changes of a pose space's free parameters."""

import hashlib
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.errors import InputError, require
from torchhand.files.disk import opened_arrays
from torchhand.hand import PoseSpace
from torchhand.study import PerturbationSettings, draw_perturbations, spread_of_starts

_MIN_STD = 1e-4  # metres or radians: of what is not perturbed at all
_SAMPLES = "perturbation"


@runtime_checkable
class Perturbation(Protocol):
    """A distribution of starts; equal ones have equal texts (`str`)."""

    def draw(self, space: PoseSpace, count: int, generator: torch.Generator) -> Float[Tensor, "starts free"]:
        """Changes of the free parameters, metres and radians; the rotation is a left perturbation of the root."""
        ...

    def std(self, space: PoseSpace) -> Float[Tensor, "free"]:
        """Standard deviations, above 0."""
        ...


@dataclass(frozen=True, kw_only=True)
class UniformPerturbation:
    """Every angle and coordinate uniform either way, the hand turned about an axis of any direction."""

    angle_deg: float = 15.0
    translation_mm: float = 10.0
    rotation_deg: float = 15.0

    def __post_init__(self) -> None:
        _ = self._settings  # checks the ranges

    def __str__(self) -> str:
        return f"uniform {self.angle_deg:g} deg {self.translation_mm:g} mm {self.rotation_deg:g} deg"

    @property
    def _settings(self) -> PerturbationSettings:
        return PerturbationSettings(
            angle_deg=self.angle_deg, translation_mm=self.translation_mm, rotation_deg=self.rotation_deg, levels=1
        )

    def draw(self, space: PoseSpace, count: int, generator: torch.Generator) -> Float[Tensor, "starts free"]:
        return draw_perturbations(space, torch.ones(count, dtype=torch.float64), self._settings, generator)

    def std(self, space: PoseSpace) -> Float[Tensor, "free"]:
        return spread_of_starts(space, self._settings)


@dataclass(frozen=True, kw_only=True)
class GaussianPerturbation:
    """Normal errors, those of the joint angles correlated: fingers close and open together."""

    angle_deg: float = 8.0
    """Standard deviations."""
    translation_mm: float = 6.0
    rotation_deg: float = 8.0
    correlation: float = 0.0
    """Between any two joint angles; 0 to 1."""

    def __post_init__(self) -> None:
        for name in ("angle_deg", "translation_mm", "rotation_deg"):
            value = getattr(self, name)
            require(0 <= value <= 1000, f"perturbation.{name}", "0 to 1000", value)
        require(0 <= self.correlation <= 1, "perturbation.correlation", "0 to 1", self.correlation)

    def __str__(self) -> str:
        size = f"{self.angle_deg:g} deg {self.translation_mm:g} mm {self.rotation_deg:g} deg"
        return f"gaussian {size} correlation {self.correlation:g}"

    def draw(self, space: PoseSpace, count: int, generator: torch.Generator) -> Float[Tensor, "starts free"]:
        own = torch.randn(count, space.size, generator=generator, dtype=torch.float64)
        common = torch.randn(count, 1, generator=generator, dtype=torch.float64)
        is_joint = torch.tensor([not name.startswith("root") for name in space.free_names])
        mixed = math.sqrt(self.correlation) * common + math.sqrt(1 - self.correlation) * own
        return torch.where(is_joint, mixed, own) * self._std(space)

    def std(self, space: PoseSpace) -> Float[Tensor, "free"]:
        return self._std(space).clamp_min(_MIN_STD)

    def _std(self, space: PoseSpace) -> Float[Tensor, "free"]:
        turn = math.radians(self.rotation_deg)
        kinds = {"root_t": 1e-3 * self.translation_mm, "root_r": turn}
        sizes = [kinds.get(name[:6], math.radians(self.angle_deg)) for name in space.free_names]
        return torch.tensor(sizes, dtype=torch.float64)


@dataclass(frozen=True, kw_only=True, eq=False)
class SampledPerturbation:
    """Errors drawn from given ones with replacement, such as those that a tracker's predictions were found to have."""

    samples: Float[Tensor, "samples free"]
    """Changes of the free parameters of the study's pose space, metres and radians; two or more."""

    def __post_init__(self) -> None:
        require(len(self.samples) >= 2, "perturbation.samples", "two or more", len(self.samples))
        require(bool(self.samples.isfinite().all()), "perturbation.samples", "finite numbers", "others")

    @classmethod
    def of_file(cls, path: Path) -> "SampledPerturbation":
        """The array `perturbation` of an npz file, such as the hypotheses.npz of a study. Raises InputError."""
        complaint = f"expected an npz file with {_SAMPLES}; it cannot be read as one"
        with opened_arrays(path, complaint=complaint) as stored:
            if _SAMPLES not in stored:
                raise InputError(f"{path}: expected {_SAMPLES} (samples, free), got {', '.join(stored) or 'nothing'}")
            samples = np.asarray(stored[_SAMPLES])
        if samples.ndim != 2 or not np.issubdtype(samples.dtype, np.number):
            raise InputError(f"{path}: {_SAMPLES}: expected numbers of shape (samples, free), got {samples.shape}")
        return cls(samples=torch.from_numpy(samples.astype(np.float64)))

    def __str__(self) -> str:
        digest = hashlib.sha256(self.samples.double().numpy().tobytes()).hexdigest()[:8]
        return f"{len(self.samples)} samples {digest}"

    def draw(self, space: PoseSpace, count: int, generator: torch.Generator) -> Float[Tensor, "starts free"]:
        self._check(space)
        return self.samples.double()[torch.randint(len(self.samples), (count,), generator=generator)]

    def std(self, space: PoseSpace) -> Float[Tensor, "free"]:
        self._check(space)
        return self.samples.double().square().mean(0).sqrt().clamp_min(_MIN_STD)

    def _check(self, space: PoseSpace) -> None:
        if self.samples.shape[1] != space.size:
            raise InputError(
                f"perturbation.samples: expected {space.size} numbers a sample, the free parameters of the pose space,"
                f" got {self.samples.shape[1]}"
            )


def perturbation_of(value: Any) -> Perturbation:
    """What YAML says of a perturbation: {kind: uniform | gaussian | samples, ...}. Raises ValueError or InputError."""
    if not isinstance(value, dict):
        return value
    given = dict(value)
    kind = given.pop("kind", None)
    kinds = {"uniform": UniformPerturbation, "gaussian": GaussianPerturbation}
    if kind == "samples" and set(given) == {"file"}:
        return SampledPerturbation.of_file(Path(str(given["file"])))
    require(kind in kinds, "perturbation.kind", f"{', '.join(kinds)}, or samples with file", kind)
    fields = kinds[kind].__dataclass_fields__
    for name, number in given.items():
        require(name in fields, "perturbation", f"keys of {', '.join(fields)}", name)
        require(isinstance(number, (int, float)), f"perturbation.{name}", "a number", number)
    return kinds[kind](**{name: float(number) for name, number in given.items()})
