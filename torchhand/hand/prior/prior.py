"""How likely a pose and a shape are for a human hand: log-probability, a smooth energy, and a sampler."""

import math
from dataclasses import dataclass, field

import torch
from jaxtyping import Float
from torch import Tensor, nn

from torchhand.errors import require_kind
from torchhand.hand.kinematics import DOFS, HandKinematics, ShapeSpace, Skeleton
from torchhand.hand.limits import Anthropometry, AnthropometrySettings, ConstraintSettings, PoseConstraints
from torchhand.hand.primitives import PenetrationSettings, energy_of, penetration, place_primitives, primitive_sizes
from torchhand.hand.prior.components import PostureComponent
from torchhand.hand.prior.mixture import PostureMixture
from torchhand.hand.prior.postures import COMPONENTS
from torchhand.precision import full_precision, require_exact

_CHUNK = 1024  # hands that are placed at once when sampling
_MAX_PROPOSALS = 32 * _CHUNK  # proposals of one round
_PATIENCE, _MIN_ACCEPTED = 10_000, 1e-3  # tries after which sampling gives up if it keeps a smaller share than that


@dataclass(frozen=True, kw_only=True)
class HandPriorSettings:
    """What the prior is made of."""

    constraints: ConstraintSettings = field(default_factory=ConstraintSettings)
    anthropometry: AnthropometrySettings = field(default_factory=AnthropometrySettings)
    penetration: PenetrationSettings | None = field(default_factory=PenetrationSettings)
    """Settings of the penetration; None lets parts of the hand pass through each other: the density is then normalised
    exactly."""
    deepest: float = 0.004
    """No sample, and no pose of finite log-probability, has a pair of parts deeper in each other than its slack and
    this, metres; above 0."""
    components: tuple[PostureComponent, ...] = COMPONENTS
    """Postures of the mixture."""

    def __post_init__(self) -> None:
        if not self.deepest > 0:
            raise ValueError(f"deepest: expected above 0, got {self.deepest!r}")


class HandPrior(nn.Module):
    """p(pose, shape) ∝ postures(joint angles) · population(shape) · exp(−penetration(joint angles, shape)).

    `postures` is a mixture of truncated normals on the feasible set (`PostureMixture`), normalised exactly;
    `population` a normal distribution cut off at the 21 anthropometric intervals and the shape's bounds
    (`Anthropometry`); penetration as in `penetration`, infinite beyond `settings.deepest`. The constant that cutting
    off and penetration take away is left out: log-probabilities of one prior can be compared, and `sample` follows them
    exactly. The root is uniform, which is improper: it has no part in the density, and samples have it at zero.
    """

    def __init__(
        self,
        skeleton: Skeleton,
        shape_space: ShapeSpace,
        settings: HandPriorSettings | None = None,
        *,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        """
        skeleton, shape_space: of a hand model; `HandModel.prior` gives them.
        dtype: what to compute in, float32 or float64; for float64 say so here instead of converting the module later.
        """
        super().__init__()
        require_exact("dtype", dtype)
        self.settings = settings or HandPriorSettings()
        self.constraints = PoseConstraints(skeleton, self.settings.constraints)
        self.population = Anthropometry(shape_space, self.settings.anthropometry)
        self.postures = PostureMixture(self.constraints, self.settings.components)
        self.kinematics = HandKinematics(skeleton, shape_space).to(dtype)

    @full_precision
    def log_prob(
        self, pose: Float[Tensor, "*batch 36"], shape: Float[Tensor, "*#batch shape"] | None = None
    ) -> Float[Tensor, "*batch"]:
        """Log-probability up to one constant; minus infinity where a hard constraint is broken.

        Raises ValueError for numbers that are too many, too few, or of another dtype than the prior's; TypeError for
        what is no tensor.

        Without a shape that of the pose for the default shape. The gradient is finite inside; outside it is that of
        `energy` without the walls, so that it still leads towards likelier poses. A NaN gives minus infinity.
        """
        self._check(pose, shape)
        if _is_one(pose, shape):
            return self.log_prob(pose[None], None if shape is None else shape[None])[0]
        excess, cost = self._penetration(pose, shape)
        density = self.postures.log_density(pose) - cost
        possible = self.constraints.is_feasible(pose) & (excess <= self.settings.deepest)
        if shape is not None:
            density = density + self.population.log_density(shape)
            possible = possible & self.population.is_feasible(shape)
        return torch.where(possible, density, -torch.inf)

    @full_precision
    def energy(
        self, pose: Float[Tensor, "*batch 36"], shape: Float[Tensor, "*#batch shape"] | None = None
    ) -> Float[Tensor, "*batch"]:
        """−log_prob with smooth walls in place of the infinite ones: finite everywhere, for losses and fitting.

        On the feasible set, and no deeper than `settings.deepest`, it is −log_prob exactly. Raises as that does. Where
        parts overlap it is differentiable once: second derivatives lack that of the penetration (see `penetration`).
        """
        self._check(pose, shape)
        if _is_one(pose, shape):
            return self.energy(pose[None], None if shape is None else shape[None])[0]
        _, cost = self._penetration(pose, shape)
        energy = cost - self.postures.log_density(pose) + self.constraints.wall(pose)
        if shape is not None:
            energy = energy - self.population.log_density(shape) + self.population.penalty(shape)
        return energy

    def sample(
        self, count: int, generator: torch.Generator, *, dtype: torch.dtype | None = None
    ) -> tuple[Float[Tensor, "count 36"], Float[Tensor, "count shape"]]:
        """Poses, root at zero, and shapes of random people; every one feasible, drawn by rejection.

        On the module's device and, where `dtype` is None, in its dtype. The generator is one of the CPU; the same seed
        gives the same samples bit for bit on the same machine.
        """
        if count < 0:
            raise ValueError(f"count: expected 0 or more, got {count}")
        dtype = self.kinematics.default_shape.dtype if dtype is None else dtype
        require_exact("dtype", dtype)
        poses, shapes, found, tried = [], [], 0, 0
        while found < count:
            rate = max(found, 1) / tried if tried else 1.0
            wanted = min(max(math.ceil(1.1 * (count - found) / rate), 16), _MAX_PROPOSALS)
            pose, shape = self._propose(wanted, generator)
            chance = torch.rand(wanted, generator=generator, dtype=torch.float64)
            kept = self._accepts(pose, shape, chance)
            poses.append(pose[kept].to(dtype))
            shapes.append(shape[kept].to(dtype))
            found, tried = found + int(kept.sum()), tried + wanted
            if tried >= _PATIENCE and found < _MIN_ACCEPTED * tried:
                raise ValueError(
                    f"sample: expected postures that hardly penetrate themselves, found {found} in {tried} tries"
                )
        empty_pose, empty_shape = (empty.to(dtype) for empty in self._propose(0, generator))
        return torch.cat((empty_pose, *poses))[:count], torch.cat((empty_shape, *shapes))[:count]

    def _check(self, pose: Tensor, shape: Tensor | None) -> None:
        dtype = self.kinematics.default_shape.dtype
        for name, value in (("pose", pose),) if shape is None else (("pose", pose), ("shape", shape)):
            require_kind(name, value, Tensor)
            if value.dtype != dtype:
                raise ValueError(f"{name}: expected {dtype}, in which the prior computes, got {value.dtype}")
        if pose.ndim == 0 or pose.shape[-1] != len(DOFS):
            raise ValueError(f"pose: expected {len(DOFS)} numbers in the last dimension, got shape {tuple(pose.shape)}")
        if shape is not None:
            self.kinematics.shape_space.check_width(shape)

    def _propose(self, count: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Before rounding to any dtype but float64."""
        pose, _ = self.postures.sample(count, generator, dtype=torch.float64)
        return pose, self.population.sample(count, generator, dtype=torch.float64).to(pose)

    @torch.no_grad()
    def _accepts(self, pose: Tensor, shape: Tensor, chance: Tensor) -> Tensor:
        kept = []
        for poses, shapes, chances in zip(*(x.split(_CHUNK) for x in (pose, shape, chance)), strict=True):
            like = self.kinematics.default_shape
            excess, cost = self._penetration(poses.to(like), shapes.to(like))
            kept.append((excess <= self.settings.deepest) & (chances.to(cost.device) < torch.exp(-cost.double())))
        return torch.cat(kept)

    def _penetration(self, pose: Tensor, shape: Tensor | None) -> tuple[Tensor, Tensor]:
        """The largest depth beyond the slack (metres), and what all of them cost."""
        if self.settings.penetration is None:
            return torch.zeros_like(pose[..., 0]), torch.zeros_like(pose[..., 0])
        still = torch.cat((torch.zeros_like(pose[..., :6]), pose[..., 6:]), -1)
        sizes = primitive_sizes(self.kinematics.shape_space, self.kinematics.default_shape if shape is None else shape)
        depths = penetration(place_primitives(self.kinematics(still, shape), sizes), self.settings.penetration)
        return depths.worst, energy_of(depths, self.settings.penetration)


def _is_one(pose: Tensor, shape: Tensor | None) -> bool:
    """Whether this is one hand without a batch dimension. Such a hand is a batch of one: the forward mode of torch.func
    gives float64 for products of a number and a float32 tensor that has no dimension (torch 2.13)."""
    return pose.ndim == 1 and (shape is None or shape.ndim == 1)
