"""The protocol of observations and priors: data are associated with posed hands, which gives a factor of the cost.

A factor is a negative log-likelihood in nats with its second-order model in the 36 degrees of freedom, so that kinds,
cameras and frames add up. To observe something new is to write one class with `associate`, and the factor that it
returns; it then works in `solve` over many hypotheses, in the shape fit and in the trackers.
"""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, TypeVar, runtime_checkable

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.fit.schedule import Stage
from torchhand.fit.shared import SharedUnknowns
from torchhand.hand import HandPose

T = TypeVar("T")
Own = TypeVar("Own", bound="OwnFactor")


@dataclass(frozen=True, kw_only=True)
class PosedHands:
    """Hands of one shape in some poses, as factors are asked about them; a row per hand.

    What several factors need of the same hands is computed once and kept (`once`).
    """

    pose: HandPose
    """Poses (k,), within the joint limits."""
    shape: Float[Tensor, "shape"]
    unknowns: SharedUnknowns | None = None
    """Shared unknowns in which derivatives are wanted; None for those of the pose alone."""
    extra: Float[Tensor, "extra"] | None = None
    """The numbers after the shape among the shared unknowns."""
    kept: dict[Hashable, Any] = field(default_factory=dict, repr=False, compare=False)
    kept_of_shape: dict[Hashable, Any] = field(default_factory=dict, repr=False, compare=False)
    """Cache of what depends on the shape alone: all rows and frames of a problem have it in common."""

    def __len__(self) -> int:
        return len(self.pose)

    def once(self, key: Hashable, make: Callable[[], T]) -> T:
        """What `make` returns, computed the first time."""
        if key not in self.kept:
            self.kept[key] = make()
        return self.kept[key]

    def once_for_shape(self, key: Hashable, make: Callable[[], T]) -> T:
        """What `make` returns for the shape, whatever the poses; computed the first time."""
        if key not in self.kept_of_shape:
            self.kept_of_shape[key] = make()
        return self.kept_of_shape[key]


@dataclass(frozen=True, kw_only=True)
class Equations:
    """A cost in nats and its quadratic model cost + gradient · d + ½ dᵀ matrix d; a row per hand.

    The gradient is the exact derivative of the cost, the matrix a positive semi-definite second derivative
    (Gauss-Newton).
    """

    cost: Float[Tensor, "k"]
    gradient: Float[Tensor, "k dofs"]
    matrix: Float[Tensor, "k dofs dofs"]
    first_dof: int = 0
    """Degree of freedom that the first row of gradient and matrix stands for; the cost depends on none before it."""
    mixed: Float[Tensor, "k dofs c"] | None = None
    """Second derivative in pose and shared unknowns; None where these were not asked for or do not matter."""
    shared_gradient: Float[Tensor, "k c"] | None = None
    shared_matrix: Float[Tensor, "k c c"] | None = None

    @classmethod
    def cat(cls, parts: "Sequence[Equations]") -> "Equations":
        """Equations of the hands of all parts, at least one, one part after the other."""
        if len(parts) == 1:
            return parts[0]

        def whole(name: str) -> Any:
            values = [getattr(part, name) for part in parts]
            return None if values[0] is None else torch.cat(values)

        names = ("cost", "gradient", "matrix", "mixed", "shared_gradient", "shared_matrix")
        return cls(first_dof=parts[0].first_dof, **{name: whole(name) for name in names})

    @classmethod
    def of_rows(
        cls,
        residual: Float[Tensor, "k m"],
        weight: Float[Tensor, "k m"],
        rows: Float[Tensor, "k m dofs"],
        cost: Float[Tensor, "k"],
        *,
        first_dof: int = 0,
        shared: Float[Tensor, "k m c"] | None = None,
    ) -> "Equations":
        """Equations from residuals r with derivatives J: matrix Jᵀ W J and gradient Jᵀ W r of the weights W, with a
        given cost.

        For a robust loss ½ Σ w ρ(r²) the weight is w ρ'(r²) (iteratively reweighted least squares; exact gradient).
        """
        weighted = weight[..., None] * rows
        pull = (weight * residual)[:, None]
        found = cls(cost=cost, gradient=(pull @ rows).squeeze(1), matrix=weighted.mT @ rows, first_dof=first_dof)
        if shared is None:
            return found
        return replace(
            found,
            mixed=weighted.mT @ shared,
            shared_gradient=(pull @ shared).squeeze(1),
            shared_matrix=shared.mT @ (weight[..., None] * shared),
        )


@dataclass(frozen=True, kw_only=True)
class Explained:
    """How well hands explain the data of one observation in one view; a row per hand."""

    name: str
    """Name of the observation's kind."""
    view: int | None
    """Index of the view; None for what is seen by all views together."""
    fraction: Float[Tensor, "k"]
    """Share of the data that the hand explains, 0 to 1."""
    distance: Float[Tensor, "k"]
    """Mean distance of the data from the hand, cut off where residuals are gross: px of that view, metres without
    one."""
    inside: Float[Tensor, "k"] | None = None
    """Share of the hand that lies where the data allow a hand; None where the data say nothing of that kind."""

    @classmethod
    def cat(cls, parts: "Sequence[Explained]") -> "Explained":
        """Explanations of one kind and view, for the hands of all parts; what is not told of all is not told."""
        inside = [one.inside for one in parts if one.inside is not None]
        return replace(
            parts[0],
            fraction=torch.cat([one.fraction for one in parts]),
            distance=torch.cat([one.distance for one in parts]),
            inside=torch.cat(inside) if len(inside) == len(parts) else None,
        )

    @classmethod
    def joined(cls, parts: "Sequence[tuple[Explained, ...]]", counts: Sequence[int]) -> "tuple[Explained, ...]":
        """Explanations of all kinds and views, for the hands of all parts, whose numbers are `counts`; NaN for the
        hands of a part in which there were no data of that kind and view."""
        if all(len(part) == len(parts[0]) for part in parts):
            return tuple(cls.cat(own) for own in zip(*parts, strict=True))
        found = [_by_kind(part) for part in parts]
        whole = []
        for key, like in {key: one for part in found for key, one in part.items()}.items():
            nothing = [like.fraction.new_full((count,), torch.nan) for count in counts]
            own = [
                part.get(key, cls(name=like.name, view=like.view, fraction=empty, distance=empty))
                for part, empty in zip(found, nothing, strict=True)
            ]
            whole.append(cls.cat(own))
        return tuple(whole)

    def rows(self, rows: "Int[Tensor, 'n'] | slice") -> "Explained":
        """The rows of the given hands."""
        inside = None if self.inside is None else self.inside[rows]
        return replace(self, fraction=self.fraction[rows], distance=self.distance[rows], inside=inside)


def _by_kind(explained: Sequence[Explained]) -> dict[tuple[str, int | None, int], Explained]:
    """Explanations by name, view, and how many of that name and view come before."""
    found: dict[tuple[str, int | None, int], Explained] = {}
    for one in explained:
        found[one.name, one.view, sum(key[:2] == (one.name, one.view) for key in found)] = one
    return found


@runtime_checkable
class Factor(Protocol):
    """One term of the cost, frozen about the hands that data were associated with."""

    def equations(self, hands: PosedHands) -> Equations:
        """Equations at the given hands, a row for each; rotation vectors are about the references of the
        association."""
        ...

    def rows(self, rows: Int[Tensor, "n"]) -> "Factor":
        """The rows of some of the hands."""
        ...

    def explained(self) -> tuple[Explained, ...]:
        """How well the associated hands explain the data; nothing for a prior."""
        ...


@runtime_checkable
class Observation(Protocol):
    """Data, or a prior belief, about hands."""

    @property
    def is_empty(self) -> bool:
        """Whether there is nothing to compare a hand with; never so for a prior."""
        ...

    def rows(self, rows: "Int[Tensor, 'n'] | slice") -> "Observation":
        """The rows of some of the hypotheses or frames; itself where the data are the same for all."""
        ...

    def associate(self, hands: PosedHands, stage: Stage) -> Factor:
        """Decides which data belong to which part of the posed hands, and freezes that."""
        ...


class OwnFactor:
    """What is its own factor, one and the same for all hypotheses, and has no data that are explained."""

    @property
    def is_empty(self) -> bool:
        """False"""
        return False

    def rows(self: Own, rows: "Int[Tensor, 'n'] | slice") -> Own:
        """Itself."""
        return self

    def associate(self: Own, hands: PosedHands, stage: Stage) -> Own:
        """Itself."""
        return self

    def explained(self) -> tuple[Explained, ...]:
        """Nothing."""
        return ()
