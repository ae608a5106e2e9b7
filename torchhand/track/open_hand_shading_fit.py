"""Pose and shape of an open hand from its shading and its outline together.

Levenberg-Marquardt from the fit to the outline alone, on coarse squares first and on blurred residuals, which let a
joint that is squares away from its place find the way. Most photographs of hands are no case for it, skin being no
Lambertian surface of one reflectance and the primitives no skin. So the residuals decide: only where they end up as
noise, about equal in size to the differences of neighbours, is the result believed.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from torchhand.geometry import Camera
from torchhand.hand import HandKinematics
from torchhand.numerics.least_squares import LevenbergMarquardtSettings, NormalEquations
from torchhand.numerics.levenberg_marquardt import levenberg_marquardt
from torchhand.track.contour_points import hand_length_px
from torchhand.track.open_hand_edges import Outline, OutlineTerm
from torchhand.track.open_hand_pixels import PixelGrid, pixel_grid
from torchhand.track.open_hand_problem import OpenHandProblem
from torchhand.track.open_hand_settings import OpenHandSettings
from torchhand.track.open_hand_shading import Shading, ShadingRows

_LEAST_NOISE = 0.5  # grey levels that are believed of a square
_BLOCK = 8  # squares to a side of the blocks whose means tell whether neighbours err alike
_DAMPING = 1e-3  # first, of Levenberg-Marquardt
_COST_TOLERANCE = 1e-4


@dataclass(frozen=True)
class _Stage:
    """One minimisation."""

    coarseness: int
    """Side of the squares over that of the finest."""
    blur: float
    """Standard deviation of the Gaussian over the residuals, squares."""
    most: float
    """Residuals beyond so many grey levels hardly count."""


_COARSE, _FINE = _Stage(2, 1.5, 10.0), _Stage(1, 0.0, 6.0)
_REPEATS = 2  # of each: the noise, by which outline and prior are weighed, is only known where the fit is nearly right


@dataclass(frozen=True, kw_only=True)
class ShadingFit:
    """Unknowns at shading and outline."""

    values: Float[Tensor, "n"]
    covariance: Float[Tensor, "n n"]
    """Of the scaled unknowns."""
    noise: float
    """Robust standard deviation of the squares' brightness from the model's, grey levels."""
    outline: OutlineTerm
    """The silhouette's edge about the values."""


def fit_shading(
    image: UInt8[Tensor, "height width 3"],
    mask: Bool[Tensor, "height width"],
    camera: Camera,
    problem: OpenHandProblem,
    kinematics: HandKinematics,
    root_reference: Float[Tensor, "3 3"],
    start: Float[Tensor, "n"],
    outline: Outline,
    settings: OpenHandSettings,
) -> ShadingFit | None:
    """The most probable unknowns, or None where shading under one light does not explain the picture to its noise."""
    length_px = hand_length_px(camera, kinematics, *problem.split(start))
    finest = max(1, round(length_px / settings.squares_along))
    values, most_misfit = start, settings.most_shading_misfit
    best: tuple[ShadingRows, PixelGrid, OutlineTerm] | None = None
    for stage in (_COARSE, _FINE):
        grid = pixel_grid(image, mask, camera, stage.coarseness * finest)
        if grid is None:
            return None
        shading = Shading(grid, problem, kinematics, root_reference)
        rows = shading(values)
        for _ in range(_REPEATS):
            term = outline.term(values, settings.final_search_share, is_fine=True)
            if term is None or rows.noise > most_misfit * _contrast(grid):
                return None
            joint = _Joint(shading, stage, problem, term, max(rows.noise, _LEAST_NOISE))
            values = levenberg_marquardt(
                joint,
                values,
                lower=problem.lower,
                upper=problem.upper,
                settings=LevenbergMarquardtSettings(
                    iterations=settings.shading_iterations, damping=_DAMPING, cost_tolerance=_COST_TOLERANCE
                ),
                first=joint.equations(values, rows),
            ).values
            rows, most_misfit = joint.best, settings.most_shading_rest
            best = rows, grid, term
    if best is None or not _is_noise(best[0], best[1], settings):
        return None
    rows, _, term = best
    covariance = _covariance(values, rows, problem, term, settings)
    return ShadingFit(values=values, covariance=covariance, noise=rows.noise, outline=term)


class _Joint:
    """Cost of shading, outline and prior together, and its quadratic model."""

    def __init__(
        self, shading: Shading, stage: _Stage, problem: OpenHandProblem, outline: OutlineTerm, noise: float
    ) -> None:
        self._shading, self._stage, self._problem, self._outline = shading, stage, problem, outline
        self._noise = noise
        self._least = float("inf")
        self.best: ShadingRows
        """Of the values with the least cost so far."""

    def __call__(self, values: Float[Tensor, "n"]) -> NormalEquations:
        return self.equations(values, self._shading(values))

    def equations(self, values: Float[Tensor, "n"], rows: ShadingRows) -> NormalEquations:
        outline, apart = self._outline, values - self._outline.values
        known, slope = self._problem.prior(values)
        seen = self._of_shading(rows)
        drag = outline.information @ apart
        cost = seen.cost + 0.5 * known.square().sum() + 0.5 * apart @ drag - apart @ outline.pull
        if float(cost) < self._least:
            self._least, self.best = float(cost), rows
        return NormalEquations(
            matrix=seen.matrix + slope.T @ slope + outline.information,
            gradient=seen.gradient + slope.T @ known + drag - outline.pull,
            cost=cost,
        )

    def _of_shading(self, rows: ShadingRows) -> NormalEquations:
        """The light is solved for on the way; squares that cannot be explained cost as much as others on average."""
        noise, most = self._noise, self._stage.most
        trust = (noise**2 + rows.variance).rsqrt()
        far = 1 + (rows.residual / most).square()
        residual = trust * rows.residual / far.sqrt()
        slope = (trust * far**-1.5)[:, None] * torch.cat((rows.jacobian, rows.light), -1)
        if self._stage.blur > 0:
            residual, slope = self._blurred(rows, residual, slope)
        share = rows.candidates / max(len(residual), 1)
        matrix, pull = slope.T @ slope, slope.T @ residual
        count = rows.jacobian.shape[-1]
        light = matrix[count:, count:] + _ridge(matrix[count:, count:])
        solved = torch.linalg.solve(light, torch.cat((matrix[count:, :count], pull[count:, None]), -1))
        return NormalEquations(
            matrix=share * (matrix[:count, :count] - matrix[:count, count:] @ solved[:, :-1]),
            gradient=-share * (pull[:count] - matrix[:count, count:] @ solved[:, -1]),
            cost=0.5 * share * residual.square().sum(),
        )

    def _blurred(self, rows: ShadingRows, residual: Tensor, slope: Tensor) -> tuple[Tensor, Tensor]:
        height, width = self._shading.grid.size
        square = rows.square.numpy()
        layers = np.zeros((height * width, slope.shape[1] + 1), np.float32)
        layers[square] = torch.cat((slope, residual[:, None]), -1).numpy()
        soft = cv2.GaussianBlur(layers.reshape(height, width, -1), (0, 0), self._stage.blur)
        found = torch.from_numpy(soft.reshape(height * width, -1)[square]).to(residual)
        return found[:, -1], found[:, :-1]


def _ridge(matrix: Tensor) -> Tensor:
    return 1e-9 * (matrix.diagonal().sum() + 1) * torch.eye(len(matrix), dtype=matrix.dtype)


def _contrast(grid: PixelGrid) -> float:
    """Standard deviation of the brightness over the hand, grey levels."""
    return float(grid.value[grid.is_inside].std())


def _is_noise(rows: ShadingRows, grid: PixelGrid, settings: OpenHandSettings) -> bool:
    """Whether neighbours differ as much as the residuals' size lets expect, and blocks of them average out."""
    height, width = grid.size
    field = torch.full((height * width,), torch.nan, dtype=torch.float64)
    field[rows.square] = rows.residual.clamp(-4 * rows.noise, 4 * rows.noise)
    field = field.reshape(height, width)
    steps = torch.cat([(field[1:] - field[:-1]).flatten(), (field[:, 1:] - field[:, :-1]).flatten()])
    steps = steps[steps.isfinite()]
    if len(steps) < _BLOCK**2:
        return False
    of_neighbours = 1.4826 * float(steps.abs().median()) / 2**0.5
    tall, wide = height // _BLOCK, width // _BLOCK
    blocks = field[: tall * _BLOCK, : wide * _BLOCK].reshape(tall, _BLOCK, wide, _BLOCK).transpose(1, 2).flatten(2)
    count = blocks.isfinite().sum(-1)
    full = count >= _BLOCK**2 // 3
    if not bool(full.any()):
        return False
    shared = float((blocks.nan_to_num().sum(-1)[full].square() / count[full]).mean()) ** 0.5
    return max(rows.noise, shared) < settings.most_shading_excess * of_neighbours


def _covariance(
    values: Float[Tensor, "n"],
    rows: ShadingRows,
    problem: OpenHandProblem,
    outline: OutlineTerm,
    settings: OpenHandSettings,
) -> Float[Tensor, "n n"]:
    """Of the values, plus that of the hand's size: some offsets of the model follow hand length by a fixed share, and
    would tell it, but not of a real hand."""
    joint = torch.cat((rows.jacobian, rows.light), -1)
    variance = settings.shading_std_factor**2 * (max(rows.noise, _LEAST_NOISE) ** 2 + rows.variance)
    matrix = joint.T @ (joint / variance[:, None])
    _, slope = problem.prior(values)
    count = len(values)
    matrix[:count, :count] += slope.T @ slope + outline.information
    matrix[count:, count:] += _ridge(matrix[count:, count:])
    covariance = torch.linalg.inv(matrix)[:count, :count]
    larger = problem.enlarged(values)
    return covariance + torch.outer(larger, larger) / larger.square().sum()
