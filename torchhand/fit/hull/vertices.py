"""Vertices spread over the skin of a hand, and what each of them counts in a fit."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.devices import kept, read_back
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


@kept(16)
def _spread(
    hand: Hand, count: int, dtype: torch.dtype, device: torch.device
) -> tuple[Int[Tensor, "points"], Float[Tensor, "points"]]:
    """dtype, device: the hand's, as a module may be moved."""
    return _farthest(hand, count)


def _farthest(hand: Hand, count: int) -> tuple[Int[Tensor, "points"], Float[Tensor, "points"]]:
    device = hand.faces.device
    vertices = hand.skinning.rest_vertices.T
    vertices = vertices + (hand.skinning.rest_basis @ hand.kinematics.metres(hand.kinematics.default_shape)).T
    a, b, c = vertices[hand.faces].unbind(1)
    of_face = torch.linalg.cross(b - a, c - a).norm(dim=-1) / 6
    area = torch.zeros(len(vertices), dtype=vertices.dtype, device=device)
    area = area.index_add(0, hand.faces.flatten(), of_face.repeat_interleave(3))
    # Host arrays of one coordinate each: some hundred steps of a few short operations.
    x, y, z = np.ascontiguousarray(read_back(vertices).T)
    first = int(area.argmax())
    chosen, owner = [first], np.zeros(len(x), dtype=np.int64)
    nearest = np.full_like(x, np.inf)
    for index in range(min(count, len(x))):
        if index:
            chosen.append(int(nearest.argmax()))
        last = chosen[-1]
        distance = np.sqrt((x - x[last]) ** 2 + (y - y[last]) ** 2 + (z - z[last]) ** 2)
        owner[distance < nearest] = index
        nearest = np.minimum(nearest, distance)
    fraction = torch.zeros(len(chosen), dtype=vertices.dtype, device=device)
    fraction = fraction.index_add(0, torch.from_numpy(owner).to(device), area)
    return torch.tensor(chosen, device=device), fraction / area.sum()
