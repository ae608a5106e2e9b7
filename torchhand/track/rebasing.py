"""After a measurement update: the joints back within their limits, and the root's rotation into the reference."""

from dataclasses import dataclass, replace
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.fit import free_bounds
from torchhand.geometry import rotation_from_vector
from torchhand.hand import PoseSpace, Skeleton
from torchhand.hand.limits import clamp_to_limits
from torchhand.numerics import Gaussian, mode_in_box
from torchhand.track.prior import kind_of
from torchhand.track.state import TrackerState


@dataclass(frozen=True, kw_only=True)
class Rebasing:
    """For the states of one tracker.

    A free angle stops at its own limit, and its rates with it; what is correlated with it follows (`mode_in_box`). An
    angle that is tied to it may stop before: it does so in the pose alone, and the free one goes on (FACTS section
    2.2).
    """

    space: PoseSpace
    skeleton: Skeleton

    @cached_property
    def _is_rotation(self) -> Tensor:
        return torch.tensor([kind_of(name) == "rotation" for name in self.space.free_names])

    def pose(self, state: TrackerState) -> Float[Tensor, "36"]:
        """The pose that a state believes in, within the limits; its rotation is about the state's reference."""
        return clamp_to_limits(self.space.about(state.base).dof(state.belief.mean[: self.space.size]), self.skeleton)

    def __call__(self, state: TrackerState) -> TrackerState:
        """Joint limits kept; the root's rotation moved from the belief's mean into the reference."""
        count = self.space.size
        limits = free_bounds(self.space.about(state.base), self.skeleton)
        lower, upper = torch.full_like(state.belief.mean, -torch.inf), torch.full_like(state.belief.mean, torch.inf)
        lower[:count], upper[:count] = limits
        mean, held = mode_in_box(state.belief, lower, upper)
        blocks = mean.reshape(-1, count).clone()
        blocks[1:] = torch.where(held[:count], 0.0, blocks[1:])
        kept = replace(state, belief=Gaussian(blocks.flatten(), state.belief.covariance))
        turned = rotation_from_vector(self.pose(kept)[3:6])
        blocks[0] = torch.where(self._is_rotation, 0.0, blocks[0])
        return replace(
            state, belief=Gaussian(blocks.flatten(), state.belief.covariance), reference=turned @ state.reference
        )
