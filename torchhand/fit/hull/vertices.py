"""Vertices spread over the skin of a hand, and what each of them counts in a fit."""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.fit.hull.settings import HullSettings
from torchhand.fit.hull.skin import SkinPoints, WeightedVertices
from torchhand.hand import Hand


@dataclass(frozen=True, kw_only=True)
class SkinVertices:
    """The skin of one hand as it is compared with hulls; made once for many of them."""

    skin: SkinPoints
    settings: HullSettings
    index: Int[Tensor, "points"]
    """Vertices that must be inside."""
    area_fraction: Float[Tensor, "points"]
    """Fraction of the skin's area that each of the chosen vertices stands for."""
    rigidity: Float[Tensor, "vertices"]
    """Weight of each vertex of the whole skin, by `HullSettings.rigidity_exponent`."""

    @classmethod
    def of(cls, skin: SkinPoints, settings: HullSettings) -> "SkinVertices":
        index, area_fraction = spread_vertices(skin.hand, settings.vertices)
        rigidity = skin.hand.skinning.weights.amax(0) ** settings.rigidity_exponent
        return cls(skin=skin, settings=settings, index=index, area_fraction=area_fraction, rigidity=rigidity)

    @cached_property
    def weighted(self) -> WeightedVertices:
        """The vertices that must be inside, of the skin's own shape."""
        return self.skin.weighted(self.index)


def spread_vertices(hand: Hand, count: int) -> tuple[Int[Tensor, "points"], Float[Tensor, "points"]]:
    """Vertices spread evenly over a hand's skin, and the share of its area that each stands for.

    Each is the farthest from those before it, on the open hand of the hand's default shape. At most as many as there
    are. Computed once for a hand.
    """
    return _spread(hand, count, hand.shape.dtype, hand.shape.device)


@lru_cache(maxsize=16)
def _spread(
    hand: Hand, count: int, dtype: torch.dtype, device: torch.device
) -> tuple[Int[Tensor, "points"], Float[Tensor, "points"]]:
    """dtype, device: the hand's, as a module may be moved."""
    with torch.inference_mode(False):  # kept for callers in any mode
        return _farthest(hand, count)


def _farthest(hand: Hand, count: int) -> tuple[Int[Tensor, "points"], Float[Tensor, "points"]]:
    device = hand.faces.device
    vertices = hand.skinning.rest_vertices.T
    vertices = vertices + (hand.skinning.rest_basis @ hand.kinematics.metres(hand.kinematics.default_shape)).T
    a, b, c = vertices[hand.faces].unbind(1)
    of_face = torch.linalg.cross(b - a, c - a).norm(dim=-1) / 6
    area = torch.zeros(len(vertices), dtype=vertices.dtype, device=device)
    area = area.index_add(0, hand.faces.flatten(), of_face.repeat_interleave(3))
    chosen = [int(area.argmax())]
    nearest = (vertices - vertices[chosen[0]]).norm(dim=-1)
    owner = torch.zeros(len(vertices), dtype=torch.long, device=device)
    for index in range(1, min(count, len(vertices))):
        chosen.append(int(nearest.argmax()))
        distance = (vertices - vertices[chosen[-1]]).norm(dim=-1)
        owner = torch.where(distance < nearest, index, owner)
        nearest = torch.minimum(nearest, distance)
    fraction = torch.zeros(len(chosen), dtype=vertices.dtype, device=device).index_add(0, owner, area)
    return torch.tensor(chosen, device=device), fraction / area.sum()
