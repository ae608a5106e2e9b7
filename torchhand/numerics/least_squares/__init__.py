"""Damped, bounded, robust nonlinear least squares over many problems at once, and plain gradient descent."""

from torchhand.numerics.least_squares.arrow import ArrowEquations, Eliminated
from torchhand.numerics.least_squares.box_step import after_box_step, damped_box_step
from torchhand.numerics.least_squares.descent import DescentSettings, gradient_descent
from torchhand.numerics.least_squares.levenberg_marquardt import levenberg_marquardt
from torchhand.numerics.least_squares.records import (
    LeastSquares,
    LevenbergMarquardtSettings,
    NormalEquations,
    Status,
    normal_equations,
)
from torchhand.numerics.least_squares.robust import RobustLoss

__all__ = [
    "ArrowEquations",
    "DescentSettings",
    "Eliminated",
    "LeastSquares",
    "LevenbergMarquardtSettings",
    "NormalEquations",
    "RobustLoss",
    "Status",
    "after_box_step",
    "damped_box_step",
    "gradient_descent",
    "levenberg_marquardt",
    "normal_equations",
]
