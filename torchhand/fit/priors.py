"""Priors as factors: likely postures, the constraints between joints, and a Gaussian such as a prediction."""

import math
from dataclasses import dataclass, fields, replace
from functools import cached_property

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.devices import constant_tensor
from torchhand.fit.limits import DynamicConstraints
from torchhand.fit.observation import Equations, Explained, OwnFactor, PosedHands
from torchhand.fit.posture import PostureResiduals
from torchhand.fit.schedule import Stage
from torchhand.geometry import vector_from_rotation
from torchhand.hand import DOFS, HandPose, PoseConstraints, PoseSpace

_ROOT = 6


@dataclass(frozen=True, kw_only=True)
class ConstraintPrior(OwnFactor):
    """The constraints between joint angles (Ouhaddi and Horain 1998, eq. 1 to 5) as soft walls; the static limits hold
    exactly without it."""

    constraints: PoseConstraints
    weight: float = 1.0
    """Weight of the squared violations in units of their softness; above 0."""
    has_ties: bool = True
    """Whether the ties between joints are among them; False beside a posture prior that holds them."""

    @cached_property
    def _residuals(self) -> DynamicConstraints:
        return DynamicConstraints(constraints=self.constraints)

    def equations(self, hands: PosedHands) -> Equations:
        """Normal equations in the joint angles."""
        value, slope = self._residuals.of_joints(hands.pose.dofs, has_ties=self.has_ties)
        weighted = self.weight * slope
        return Equations(
            cost=0.5 * self.weight * value.square().sum(-1),
            gradient=(value[:, None] @ weighted).squeeze(1),
            matrix=slope.mT @ weighted,
            first_dof=_ROOT,
        )


@dataclass(frozen=True, kw_only=True)
class PosturePrior:
    """The mixture of likely postures: of each hand the component that is likeliest at the association."""

    postures: PostureResiduals
    weight: float = 1.0
    """Power of the density; above 0."""
    is_normalized: bool = False
    """Whether the cost holds the normalisation of each component, above that of the densest: costs of hands in narrow
    and in broad components are then comparable. What is one component for all compared hands does not need it."""
    tail: float = math.inf
    """Degrees of freedom of a Student's t distribution: the fewer, the less an unusual posture is pulled to the usual
    ones; infinite for a normal one."""

    @property
    def is_empty(self) -> bool:
        return False

    def rows(self, rows: "Int[Tensor, 'n'] | slice") -> "PosturePrior":
        """This prior itself, which is one and the same for all hands."""
        return self

    def associate(self, hands: PosedHands, stage: Stage) -> "PostureFactor":
        """The likeliest component, and what it counts."""
        pose = hands.pose.dofs
        known = pose.nan_to_num()
        postures = self.postures.on(pose.device)
        kind = postures.likeliest(known)
        matrix, offset = postures.matrix.to(pose)[kind], postures.offset.to(pose)[kind]
        scale = math.sqrt(self.weight) * torch.ones_like(pose[:, 0])
        if not math.isinf(self.tail):
            away = ((matrix @ known[:, _ROOT:, None]).squeeze(-1) - offset).square().sum(-1)
            scale = (self.weight * (self.tail + offset.shape[-1]) / (self.tail + away)).sqrt()
        matrix, offset = scale[:, None, None] * matrix, scale[:, None] * offset
        level = torch.zeros_like(pose[:, 0])
        if self.is_normalized:
            level = self.weight * (postures.level - postures.level.min()).to(pose)[kind]
        return PostureFactor(matrix=matrix, offset=offset, level=level, information=matrix.mT @ matrix)


@dataclass(frozen=True, kw_only=True)
class PostureFactor:
    """Residuals of one component for each hand: matrix · joint angles - offset, in standard deviations."""

    matrix: Float[Tensor, "k 30 30"]
    offset: Float[Tensor, "k 30"]
    level: Float[Tensor, "k"]
    """Cost where nothing is missed, nats."""
    information: Float[Tensor, "k 30 30"]

    def equations(self, hands: PosedHands) -> Equations:
        """Normal equations in the joint angles."""
        missed = (self.matrix @ hands.pose.dofs[:, _ROOT:, None]).squeeze(-1) - self.offset
        return Equations(
            cost=0.5 * missed.square().sum(-1) + self.level,
            gradient=(missed[:, None] @ self.matrix).squeeze(1),
            matrix=self.information,
            first_dof=_ROOT,
        )

    def rows(self, rows: Int[Tensor, "n"]) -> "PostureFactor":
        """The rows of some of the hands."""
        return PostureFactor(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})

    def explained(self) -> tuple[Explained, ...]:
        return ()


@dataclass(frozen=True, kw_only=True)
class GaussianPrior:
    """A pose that is expected, such as a prediction, with its covariance in the free parameters of a pose space."""

    pose: HandPose
    """Expected pose: (), for all hypotheses, or (k,), one for each."""
    information: Float[Tensor, "*#k free free"]
    """Inverse covariance of the free parameters, the rotation a left perturbation of the pose."""
    space: PoseSpace

    @classmethod
    def of_covariance(
        cls, pose: HandPose, covariance: Float[Tensor, "*#k free free"], space: PoseSpace
    ) -> "GaussianPrior":
        """The covariance must be positive definite."""
        factor = torch.linalg.cholesky(covariance)
        return cls(pose=pose, information=torch.cholesky_inverse(factor), space=space)

    @classmethod
    def of_std(cls, pose: HandPose, std: Float[Tensor, "free"], space: PoseSpace) -> "GaussianPrior":
        """A prior with independent errors; an infinite standard deviation expects nothing."""
        return cls(pose=pose, information=torch.diag(std.reciprocal().square()), space=space)

    @property
    def is_empty(self) -> bool:
        return False

    @cached_property
    def _rotation(self) -> Float[Tensor, "*#k 3 3"]:
        return self.pose.rotation

    @cached_property
    def _in_dofs(self) -> Float[Tensor, "*#k 36 36"]:
        """The information of the DOFs that free parameters are named after; zero in others."""
        information, size = self.information, len(DOFS)
        rows = constant_tensor(tuple(map(DOFS.index, self.space.free_names)), torch.long, information.device)
        factor = self.space.basis[rows].diagonal().to(information)
        matrix = information.new_zeros(*information.shape[:-2], size, size)
        matrix[..., rows[:, None], rows] = information / (factor[:, None] * factor)
        return matrix

    def associate(self, hands: PosedHands, stage: Stage) -> "GaussianFactor":
        """The expected rotation about the references of the hands."""
        like, count, size = hands.pose.dofs, len(hands), len(DOFS)
        turn = vector_from_rotation(self._rotation.to(like) @ hands.pose.reference.mT)
        expected = self.pose.dofs.to(like).expand(count, size)
        return GaussianFactor(
            expected=torch.cat((expected[:, :3], turn, expected[:, _ROOT:]), -1),
            information=self._in_dofs.to(like).expand(count, size, size),
        )

    def rows(self, rows: "Int[Tensor, 'n'] | slice") -> "GaussianPrior":
        """The rows of some of the hypotheses; itself where it is the same for all."""
        if not self.pose.batch_shape:
            return self
        information = self.information if self.information.ndim == 2 else self.information[rows]
        return replace(self, pose=self.pose[rows], information=information)


@dataclass(frozen=True, kw_only=True)
class GaussianFactor:
    """Half the squared distance from the expected pose in the metric of its information."""

    expected: Float[Tensor, "k 36"]
    """Rotations about the references of the association."""
    information: Float[Tensor, "k 36 36"]
    """Zero in the DOFs that no free parameter is named after."""

    def equations(self, hands: PosedHands) -> Equations:
        """Normal equations in all DOFs."""
        deviation = hands.pose.dofs - self.expected
        pull = (self.information @ deviation[..., None]).squeeze(-1)
        return Equations(cost=0.5 * (deviation * pull).sum(-1), gradient=pull, matrix=self.information)

    def rows(self, rows: Int[Tensor, "n"]) -> "GaussianFactor":
        """The rows of some of the hands."""
        return GaussianFactor(expected=self.expected[rows], information=self.information[rows])

    def explained(self) -> tuple[Explained, ...]:
        return ()
