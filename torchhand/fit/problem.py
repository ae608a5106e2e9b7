"""One estimation problem: poses of a hand in a pose space that explain observations under priors."""

from collections.abc import Hashable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.devices import constant_tensor
from torchhand.fit.bounds import free_bounds
from torchhand.fit.observation import Equations, Explained, Factor, Observation, PosedHands
from torchhand.fit.schedule import Stage
from torchhand.fit.shared import SharedUnknowns
from torchhand.hand import DOFS, HandPose, PoseSpace, Skeleton
from torchhand.hand.limits import clamp_to_limits
from torchhand.numerics.least_squares import NormalEquations

_ROTATIONS = ("root_rx", "root_ry", "root_rz")


@dataclass(frozen=True, kw_only=True)
class Problem:
    """Poses of hands of one shape, under observations and priors, whose costs in nats add up."""

    space: PoseSpace
    """Pose space that says which degrees of freedom are free, in the dtype to solve in (float64 is meant). To keep what
    a small space does not know, use `space.about(pose)`; rotations of the root are about the references of the
    poses."""
    skeleton: Skeleton
    """Skeleton whose joint limits hold."""
    shape: Float[Tensor, "shape"]
    """Shape of the hand; where it is unknown, its start."""
    observations: tuple[Observation, ...]
    priors: tuple[Observation, ...] = ()
    shared: SharedUnknowns | None = None
    """Unknowns that all rows have in common: rows are then the frames of one problem. None: rows are hypotheses that
    have nothing to do with each other."""

    @property
    def is_empty(self) -> bool:
        """Whether no observation has any data."""
        return all(one.is_empty for one in self.observations)

    def rows(self, rows: "Int[Tensor, 'n'] | slice") -> "Problem":
        """The problem with the data and priors of some of the hypotheses."""
        own = {name: tuple(one.rows(rows) for one in getattr(self, name)) for name in ("observations", "priors")}
        return replace(self, **own)

    @cached_property
    def _sources(self) -> tuple[Observation, ...]:
        """Observations that have data, and priors."""
        return (*(one for one in self.observations if not one.is_empty), *self.priors)

    @cached_property
    def _kept_of_shape(self) -> dict[Hashable, Any]:
        """What is computed once for the problem's own shape."""
        return {}

    @cached_property
    def _own_space(self) -> PoseSpace:
        """The space with rotations about the references."""
        own = self.space.constant
        turning = constant_tensor(tuple(name in _ROTATIONS for name in DOFS), torch.bool, own.device)
        return replace(self.space, constant=own.masked_fill(turning, 0.0))

    @cached_property
    def _own_skeleton(self) -> Skeleton:
        """The skeleton on the device of the space."""
        return self.skeleton.to(device=self.space.basis.device)

    @cached_property
    def bounds(self) -> tuple[Float[Tensor, "free"], Float[Tensor, "free"]]:
        """Bounds of the free parameters."""
        return free_bounds(self._own_space, self._own_skeleton)

    @cached_property
    def _rotation_columns(self) -> Int[Tensor, "rotations"]:
        names = self.space.free_names
        own = tuple(names.index(name) for name in _ROTATIONS if name in names)
        return constant_tensor(own, torch.long, self.space.basis.device)

    def values_of(self, pose: HandPose) -> Float[Tensor, "k free"]:
        """Free parameters of poses with zero rotation vectors, put into the space and its bounds."""
        values = (pose.dofs - self._own_space.constant) @ self.space.inverse.T
        return values.clamp(*self.bounds)

    def dofs_of(self, values: Float[Tensor, "k free"]) -> tuple[Float[Tensor, "k 36"], Bool[Tensor, "k 36"]]:
        """The pose of free parameters within the limits, and which DOFs follow these: others stopped at a limit."""
        wanted = self._own_space.dof(values)
        dofs = clamp_to_limits(wanted, self._own_skeleton)
        return dofs, dofs == wanted

    def pose_of(self, values: Float[Tensor, "k free"], reference: Float[Tensor, "k 3 3"]) -> HandPose:
        """Poses with their rotation vectors about the references."""
        return HandPose(dofs=self.dofs_of(values)[0], reference=reference)

    def rebased(
        self, values: Float[Tensor, "k free"], reference: Float[Tensor, "k 3 3"]
    ) -> tuple[Float[Tensor, "k free"], Float[Tensor, "k 3 3"]]:
        """The same hands, the rotation moved from the values into the reference."""
        pose = self.pose_of(values, reference).normalized()
        return values.index_fill(-1, self._rotation_columns, 0.0), pose.reference

    def hands(self, pose: HandPose, vector: Float[Tensor, "c"] | None = None) -> PosedHands:
        """As factors are asked about them."""
        if self.shared is None or vector is None:
            return PosedHands(pose=pose, shape=self.shape, kept_of_shape=self._kept_of_shape)
        shape, extra = self.shared.shape(vector, self.shape), self.shared.extras(vector)
        return PosedHands(pose=pose, shape=shape, unknowns=self.shared, extra=extra)

    def associated(
        self,
        values: Float[Tensor, "k free"],
        reference: Float[Tensor, "k 3 3"],
        stage: Stage,
        vector: Float[Tensor, "c"] | None = None,
    ) -> "Linearization":
        """The factors of all observations and priors about some hands; vector: the shared unknowns, where there are
        some."""
        hands = self.hands(self.pose_of(values, reference), vector)
        return Linearization(
            problem=self,
            hands=hands,
            values=values,
            factors=tuple(one.associate(hands, stage) for one in self._sources),
        )


@dataclass(frozen=True, kw_only=True)
class Linearization:
    """The factors of a problem, frozen about some hands; a row per hand."""

    problem: Problem
    hands: PosedHands
    values: Float[Tensor, "k free"]
    """Free parameters of the hands."""
    factors: tuple[Factor, ...]
    _last_rows: list[Any] = field(default_factory=list, init=False, repr=False, compare=False)

    def here(self) -> NormalEquations:
        """Normal equations in the free parameters, at the hands that data were associated with."""
        _, moving = self.problem.dofs_of(self.values)
        return self._in_free(self.sum(self.factors, self.hands), moving)

    def misfit(self, cost: Float[Tensor, "k"]) -> Float[Tensor, "k"]:
        """What the observations alone have in the cost at the hands that data were associated with."""
        priors = self.factors[len(self.factors) - len(self.problem.priors) :]
        hands = self.hands
        known = [hands.once(("cost", id(one)), partial(lambda one: one.equations(hands).cost, one)) for one in priors]
        return cost - sum(known, torch.zeros_like(cost))

    def equations(self, values: Float[Tensor, "n free"], rows: Int[Tensor, "n"]) -> NormalEquations:
        """Normal equations in the free parameters, at other values of the given rows."""
        reference, factors = self._of_rows(rows)
        dofs, moving = self.problem.dofs_of(values)
        hands = replace(self.hands, pose=HandPose(dofs=dofs, reference=reference), kept={})
        return self._in_free(self.sum(factors, hands), moving)

    def _of_rows(self, rows: Int[Tensor, "n"]) -> tuple[Float[Tensor, "n 3 3"], tuple[Factor, ...]]:
        """References and factors of the given rows; those of the last rows are kept, as an optimiser asks for the same
        ones step after step."""
        if len(rows) == len(self.hands):
            return self.hands.pose.reference, self.factors
        last = self._last_rows
        if not last or last[0] is not rows:
            last[:] = rows, (self.hands.pose.reference[rows], tuple(factor.rows(rows) for factor in self.factors))
        return last[1]

    def explained(self) -> tuple[Explained, ...]:
        """What is explained by the hands that data were associated with, observation by observation and view by
        view."""
        return tuple(one for factor in self.factors for one in factor.explained())

    def sum(self, factors: tuple[Factor, ...], hands: PosedHands) -> Equations:
        """The cost of all factors in the 36 DOFs."""
        like, count, size = self.values, len(hands), len(DOFS)
        cost, gradient = like.new_zeros(count), like.new_zeros(count, size)
        matrix = like.new_zeros(count, size, size)
        shared: _SharedSum | None = None
        if hands.unknowns is not None:
            shared = _SharedSum.zero(like, count, hands.unknowns.size)
        for factor in factors:
            own = factor.equations(hands)
            hands.kept["cost", id(factor)] = own.cost
            dofs = slice(own.first_dof, own.first_dof + own.gradient.shape[1])
            cost += own.cost
            gradient[:, dofs] += own.gradient
            matrix[:, dofs, dofs] += own.matrix
            if shared is not None:
                shared.add(own, dofs)
        if shared is None:
            return Equations(cost=cost, gradient=gradient, matrix=matrix)
        return Equations(
            cost=cost,
            gradient=gradient,
            matrix=matrix,
            mixed=shared.mixed,
            shared_gradient=shared.gradient,
            shared_matrix=shared.matrix,
        )

    def basis(self, moving: Bool[Tensor, "k 36"]) -> Float[Tensor, "k 36 free"]:
        """How the DOFs follow the free parameters."""
        return moving[..., None] * self.problem.space.basis

    def _in_free(self, found: Equations, moving: Bool[Tensor, "k 36"]) -> NormalEquations:
        basis = self.basis(moving)
        return NormalEquations(
            matrix=basis.mT @ (found.matrix @ basis),
            gradient=(found.gradient[:, None] @ basis).squeeze(1),
            cost=found.cost,
        )


@dataclass(frozen=True, kw_only=True)
class _SharedSum:
    """Sums over factors of the derivatives in the shared unknowns."""

    mixed: Float[Tensor, "k 36 c"]
    gradient: Float[Tensor, "k c"]
    matrix: Float[Tensor, "k c c"]

    @classmethod
    def zero(cls, like: Tensor, count: int, size: int) -> "_SharedSum":
        return cls(
            mixed=like.new_zeros(count, len(DOFS), size),
            gradient=like.new_zeros(count, size),
            matrix=like.new_zeros(count, size, size),
        )

    def add(self, own: Equations, dofs: slice) -> None:
        if own.mixed is not None and own.shared_gradient is not None and own.shared_matrix is not None:
            self.mixed[:, dofs] += own.mixed
            self.gradient.add_(own.shared_gradient)
            self.matrix.add_(own.shared_matrix)
