"""Cost of shading, outline and prior of an open hand together, for one minimisation."""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.fit.open_hand.edges import OutlineTerm
from torchhand.fit.open_hand.problem import OpenHandProblem
from torchhand.fit.open_hand.shading import Shading, ShadingRows
from torchhand.numerics import NormalEquations


@dataclass(frozen=True, kw_only=True)
class ShadingStage:
    """One minimisation."""

    side: float
    """Of the squares, over that of those which the settings count along a hand."""
    blur: float = 0.0
    """Standard deviation of the Gaussian over the residuals, squares."""
    most: float = 6.0
    """Residuals beyond so many grey levels hardly count."""
    repeats: int = 1
    """The noise, by which outline and prior are weighed, is only known where the fit is nearly right."""
    tolerance: float = 1e-4
    """It ends when a step promises to lower the cost by no more than this share."""
    is_thinned: bool = False
    """Whether only squares near creases are compared singly: those tell most."""


class JointCost:
    """Cost of shading, outline and prior together, and its quadratic model."""

    def __init__(
        self, shading: Shading, stage: ShadingStage, problem: OpenHandProblem, outline: OutlineTerm, noise: float
    ) -> None:
        self._shading, self._stage, self._problem, self._outline = shading, stage, problem, outline
        self._noise = noise
        self._least = float("inf")
        self.best: ShadingRows
        """Of the values with the least cost so far."""

    def __call__(self, values: Float[Tensor, "n"]) -> NormalEquations:
        return self.equations(values, self._shading(values))

    def equations(self, values: Float[Tensor, "n"], rows: ShadingRows) -> NormalEquations:
        edges = self._outline.equations(values)
        known, slope = self._problem.prior(values)
        seen = self._of_shading(rows)
        cost = seen.cost + 0.5 * known.square().sum() + edges.cost
        if float(cost) < self._least:
            self._least, self.best = float(cost), rows
        return NormalEquations(
            matrix=seen.matrix + slope.T @ slope + edges.matrix,
            gradient=seen.gradient + slope.T @ known + edges.gradient,
            cost=cost,
        )

    def _of_shading(self, rows: ShadingRows) -> NormalEquations:
        """The light is solved for on the way.

        Squares that cannot be explained cost as much as others on average, and those that the hand has left as much as
        the grossest: it would leave what it cannot explain at once.
        """
        noise, most = self._noise, self._stage.most
        trust = (noise**2 / rows.count + rows.variance).rsqrt()
        far = 1 + (rows.residual / most).square()
        residual = trust * rows.residual / far.sqrt()
        slope = (trust * far**-1.5)[:, None] * torch.cat((rows.jacobian, rows.light), -1)
        if self._stage.blur > 0:
            residual, slope = self._blurred(rows, residual, slope)
        share = rows.candidates / max(len(residual), 1)
        matrix, pull = slope.T @ slope, slope.T @ residual
        count = rows.jacobian.shape[-1]
        light = matrix[count:, count:] + ridge(matrix[count:, count:])
        solved = torch.linalg.solve(light, torch.cat((matrix[count:, :count], pull[count:, None]), -1))
        left = rows.lost * (most / noise) ** 2
        return NormalEquations(
            matrix=share * (matrix[:count, :count] - matrix[:count, count:] @ solved[:, :-1]),
            gradient=-share * (pull[:count] - matrix[:count, count:] @ solved[:, -1]),
            cost=0.5 * (share * residual.square().sum() + left),
        )

    def _blurred(self, rows: ShadingRows, residual: Tensor, slope: Tensor) -> tuple[Tensor, Tensor]:
        height, width = self._shading.grid.size
        square = rows.square.numpy()
        layers = np.zeros((height * width, slope.shape[1] + 1), np.float32)
        layers[square] = torch.cat((slope, residual[:, None]), -1).numpy()
        soft = cv2.GaussianBlur(layers.reshape(height, width, -1), (0, 0), self._stage.blur)
        found = torch.from_numpy(soft.reshape(height * width, -1)[square]).to(residual)
        return found[:, -1], found[:, :-1]


def ridge(matrix: Float[Tensor, "n n"]) -> Float[Tensor, "n n"]:
    """Hardly anything on the diagonal, for what the rows do not tell."""
    return 1e-9 * (matrix.diagonal().sum() + 1) * torch.eye(len(matrix), dtype=matrix.dtype)
