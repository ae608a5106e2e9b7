"""A hand as its model folder tells it: the records, and the modules that are made of them."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.hand.hand import Hand
from torchhand.hand.kinematics import HandKinematics, ShapeSpace, Side, Skeleton
from torchhand.hand.prior import HandPrior, HandPriorSettings
from torchhand.hand.skin import HandMesh


@dataclass(frozen=True, kw_only=True)
class HandModel:
    """What a model folder holds: constants in float64, modules in the dtype that is asked for."""

    name: str
    skeleton: Skeleton
    shape_space: ShapeSpace
    mesh: HandMesh | None = None
    """The mesh; None where the folder has no mesh: bones and primitives can be had all the same."""

    def to(self, *, device: torch.device | str) -> "HandModel":
        """The same model on a device, as the modules are that are made of it."""
        moved = {name: getattr(self, name).to(device=device) for name in ("skeleton", "shape_space")}
        return replace(self, **moved, mesh=None if self.mesh is None else self.mesh.to(device=device))

    def kinematics(self, side: Side = "right", *, dtype: torch.dtype = torch.float32) -> HandKinematics:
        """A kinematics module of this hand in the given precision."""
        space = self.shape_space.to(dtype=dtype)
        return HandKinematics(self.skeleton, space, side).to(dtype)

    def prior(self, settings: HandPriorSettings | None = None, *, dtype: torch.dtype = torch.float32) -> HandPrior:
        """What postures and proportions are likely: log-density, sampler and energy in the given precision."""
        prior = HandPrior(self.skeleton, self.shape_space, settings, dtype=dtype)
        return prior.to(self.skeleton.lower.device)

    def hand(
        self,
        shape: Float[Tensor, "*batch shape"] | None = None,
        *,
        side: Side = "right",
        dtype: torch.dtype = torch.float32,
    ) -> Hand:
        """A `Hand` of this model: bones, keypoints, skinned mesh and primitives; arguments and errors as there.

        Raises ValueError for a model without mesh.
        """
        if self.mesh is None:
            raise ValueError(f"model: expected one with a mesh, {self.name!r} has none (no mesh.npz in its folder)")
        mesh = self.mesh.to(device=self.skeleton.lower.device)
        return Hand(shape, skeleton=self.skeleton, shape_space=self.shape_space, mesh=mesh, side=side, dtype=dtype)
