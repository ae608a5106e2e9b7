"""The light on a hand by Lambert's law: brightness = ambient + max(light · normal, 0)."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

_ROUNDS = 6
_GROSS = 3.0  # robust standard deviations beyond which a pixel counts for less
_LEAST_STD = 0.3  # grey levels
_RIDGE = 1e-6


@dataclass(frozen=True, kw_only=True)
class Light:
    """Unknown beforehand; grey levels, the skin's reflectance included."""

    ambient: float
    towards: Float[Tensor, "3"]
    """Towards the light, times its strength; the camera's frame."""

    def brightness(self, normal: Float[Tensor, "*pixels 3"]) -> Float[Tensor, "*pixels"]:
        return self.ambient + (normal @ self.towards).clamp_min(0)

    def slope(self, normal: Float[Tensor, "*pixels 3"]) -> Float[Tensor, "*pixels 3"]:
        """Derivative of the brightness in the normal."""
        is_lit = ((normal @ self.towards) > 0).to(normal)
        return is_lit[..., None] * self.towards

    def basis(self, normal: Float[Tensor, "*pixels 3"]) -> Float[Tensor, "*pixels 4"]:
        """Derivative of the brightness in ambient and light."""
        is_lit = ((normal @ self.towards) > 0).to(normal)
        return torch.cat((torch.ones_like(normal[..., :1]), is_lit[..., None] * normal), -1)


def fit_light(
    normal: Float[Tensor, "pixels 3"], value: Float[Tensor, "pixels"], count: Float[Tensor, "pixels"] | None = None
) -> Light:
    """The light that explains most pixels: least squares, again and again with less weight for what lies far off.

    `count` tells how many pixels a value is the mean of.
    """
    count = torch.ones_like(value) if count is None else count
    weight, is_lit = count, torch.ones_like(value)
    one = torch.ones_like(normal[:, :1])
    ridge = _RIDGE * len(value) * torch.eye(4).to(normal)
    found = torch.zeros(4).to(normal)
    for _ in range(_ROUNDS):
        basis = torch.cat((one, is_lit[:, None] * normal), -1)
        weighted = weight[:, None] * basis
        found = torch.linalg.solve(weighted.T @ basis + ridge, weighted.T @ value)
        residual = value - basis @ found
        scale = _GROSS * max(1.4826 * float(residual.abs().median()), _LEAST_STD)
        weight = count * (1 + (residual / scale).square()).square().reciprocal()
        is_lit = ((normal @ found[1:]) > 0).to(normal)
    return Light(ambient=float(found[0]), towards=found[1:])
