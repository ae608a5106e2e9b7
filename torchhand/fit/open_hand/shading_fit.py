"""Pose and shape of an open hand from its shading and its outline together.

Levenberg-Marquardt from the fit to the outline alone, on coarse squares first and on blurred residuals, which let a
joint that is squares away from its place find the way; then joints are moved by trial, and at last single pixels near
the creases tell where each joint is. Most photographs of hands are no case for it, skin being no
Lambertian surface of one reflectance and the primitives no skin. So the residuals decide: only where they end up as
noise, about equal in size to the differences of neighbours, is the result believed.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from torchhand.fit.contour import hand_length_px
from torchhand.fit.open_hand.edges import Outline, OutlineTerm
from torchhand.fit.open_hand.joints import moved_joints
from torchhand.fit.open_hand.pixels import PixelGrid, pixel_grid, thinned
from torchhand.fit.open_hand.problem import OpenHandProblem
from torchhand.fit.open_hand.settings import OpenHandSettings
from torchhand.fit.open_hand.shading import Shading, ShadingRows
from torchhand.fit.open_hand.shading_cost import JointCost, ShadingStage, ridge
from torchhand.geometry import Camera
from torchhand.hand import HandKinematics
from torchhand.numerics import LevenbergMarquardtSettings, levenberg_marquardt

_LEAST_NOISE = 0.5  # grey levels that are believed of a square
_BLOCK = 8  # squares to a side of the blocks whose means tell whether neighbours err alike
_DAMPING = 1e-3  # first, of Levenberg-Marquardt
_SCANS = 3  # of the joints at most, while one seems to be in the wrong place yet
_HOPELESS = 4.0  # times the excess that is believed: no joint in the wrong place makes so much
_SETTLED = 1.6  # excess that noise and the formulas make by themselves
_ASTRAY = 2.0  # excess from which another way in may lead elsewhere
_WORTH_MORE = 0.95  # share of the excess that another scan must have left at most


_COARSE = tuple(ShadingStage(side=2.0, blur=blur, most=10.0, repeats=2, tolerance=2e-2) for blur in (1.5, 0.7))
"""The second where the first does not lead to where all joints are right: to some hands blur does no good."""
_MIDDLE = ShadingStage(side=1.0, tolerance=1e-3)
_FINE = ShadingStage(side=0.5, tolerance=3e-4, is_thinned=True)


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
    best: tuple[float, _Found, _Minimiser] | None = None
    for coarse in _COARSE:
        minimise = _Minimiser(image, mask, camera, problem, kinematics, root_reference, outline, settings)
        found = minimise(start, coarse)
        found = found and minimise(found.values, _MIDDLE)
        if found is None:
            break
        excess = _excess(found.rows, found.shading.grid)
        if best is None or excess < best[0]:
            best = (excess, found, minimise)
        if excess < _ASTRAY or excess > _HOPELESS * settings.most_shading_excess:
            break
    best = best and _settled(*best)
    if best is None or best[0] >= settings.most_shading_excess:
        return None
    _, found, minimise = best
    found = minimise(found.values, _FINE, found.shading)
    if found is None:
        return None
    return ShadingFit(
        values=found.values,
        covariance=_covariance(found.values, found.rows, problem, found.term, settings),
        noise=found.rows.noise,
        outline=found.term,
    )


def _settled(excess: float, found: "_Found", minimise: "_Minimiser") -> "tuple[float, _Found, _Minimiser]":
    """With joints that seem to be in the wrong place moved by trial: once in any case, and for as long as one does."""
    for _ in range(_SCANS):
        if excess > _HOPELESS * minimise.settings.most_shading_excess:
            break
        noise = max(found.rows.noise, _LEAST_NOISE)
        moved = minimise(moved_joints(found.shading, minimise.problem, found.values, found.rows, noise), _MIDDLE)
        if moved is None:
            break
        before, found = excess, moved
        excess = _excess(moved.rows, moved.shading.grid)
        if excess < _SETTLED or excess > _WORTH_MORE * before:
            break
    return excess, found, minimise


@dataclass(frozen=True, kw_only=True)
class _Found:
    """What one stage ended with."""

    values: Float[Tensor, "n"]
    rows: ShadingRows
    shading: Shading
    term: OutlineTerm


class _Minimiser:
    """Carries out stages on one picture."""

    def __init__(
        self,
        image: UInt8[Tensor, "height width 3"],
        mask: Bool[Tensor, "height width"],
        camera: Camera,
        problem: OpenHandProblem,
        kinematics: HandKinematics,
        root_reference: Float[Tensor, "3 3"],
        outline: Outline,
        settings: OpenHandSettings,
    ) -> None:
        self._image, self._mask, self._camera, self.problem = image, mask, camera, problem
        self._kinematics, self._root_reference = kinematics, root_reference
        self._outline, self.settings = outline, settings
        self._most_misfit = settings.most_shading_misfit

    def __call__(self, values: Float[Tensor, "n"], stage: ShadingStage, known: Shading | None = None) -> _Found | None:
        """None where the model does not fit; `known` tells a thinned stage where the creases are."""
        settings, problem = self.settings, self.problem
        length_px = hand_length_px(self._camera, self._kinematics, *problem.split(values))
        step = max(1, round(stage.side * max(1, round(length_px / settings.squares_along))))
        grid = pixel_grid(self._image, self._mask, self._camera, step)
        if grid is None:
            return None
        if stage.is_thinned and known is not None:
            grid = thinned(grid, known.near_creases(values, grid))
        shading = Shading(grid, problem, self._kinematics, self._root_reference)
        rows = shading(values)
        found: _Found | None = None
        for _ in range(stage.repeats):
            term = self._outline.term(values, settings.final_search_share, is_fine=True)
            if term is None or rows.noise > self._most_misfit * _contrast(grid):
                return None
            joint = JointCost(shading, stage, problem, term, max(rows.noise, _LEAST_NOISE))
            values = levenberg_marquardt(
                joint,
                values,
                lower=problem.lower,
                upper=problem.upper,
                settings=LevenbergMarquardtSettings(
                    iterations=settings.shading_iterations, damping=_DAMPING, cost_tolerance=stage.tolerance
                ),
                first=joint.equations(values, rows),
            ).values
            rows, self._most_misfit = joint.best, settings.most_shading_rest
            found = _Found(values=values, rows=rows, shading=shading, term=term)
        return found


def _contrast(grid: PixelGrid) -> float:
    """Standard deviation of the brightness over the hand, grey levels."""
    return float(grid.value[grid.is_inside].std())


def _excess(rows: ShadingRows, grid: PixelGrid) -> float:
    """Size of the residuals, or of what blocks of them share, over what neighbours' differences let expect: about 1
    for noise; infinite where there is too little to tell."""
    height, width = grid.size
    field = torch.full((height * width,), torch.nan, dtype=torch.float64)
    field[rows.square] = rows.residual.clamp(-4 * rows.noise, 4 * rows.noise)
    field = field.reshape(height, width)
    steps = torch.cat([(field[1:] - field[:-1]).flatten(), (field[:, 1:] - field[:, :-1]).flatten()])
    steps = steps[steps.isfinite()]
    if len(steps) < _BLOCK**2:
        return float("inf")
    of_neighbours = 1.4826 * float(steps.abs().median()) / 2**0.5
    tall, wide = height // _BLOCK, width // _BLOCK
    blocks = field[: tall * _BLOCK, : wide * _BLOCK].reshape(tall, _BLOCK, wide, _BLOCK).transpose(1, 2).flatten(2)
    count = blocks.isfinite().sum(-1)
    full = count >= _BLOCK**2 // 3
    if not bool(full.any()):
        return float("inf")
    shared = float((blocks.nan_to_num().sum(-1)[full].square() / count[full]).mean()) ** 0.5
    return max(rows.noise, shared) / max(of_neighbours, 1e-9)


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
    variance = settings.shading_std_factor**2 * (max(rows.noise, _LEAST_NOISE) ** 2 / rows.count + rows.variance)
    matrix = joint.T @ (joint / variance[:, None])
    _, slope = problem.prior(values)
    count = len(values)
    matrix[:count, :count] += slope.T @ slope + outline.information
    matrix[count:, count:] += ridge(matrix[count:, count:])
    covariance = torch.linalg.inv(matrix)[:count, :count]
    larger = problem.enlarged(values)
    return covariance + torch.outer(larger, larger) / larger.square().sum()
