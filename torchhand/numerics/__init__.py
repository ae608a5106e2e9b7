"""Estimators on tensors, batched over independent problems: they know no hand and no image."""

from torchhand.numerics.cholesky import robust_cholesky
from torchhand.numerics.consistency import chi_square_quantile, mean_chi_square_band, nees, nis
from torchhand.numerics.gaussian import Gaussian
from torchhand.numerics.least_squares import LeastSquares, LevenbergMarquardtSettings, NormalEquations, Status
from torchhand.numerics.levenberg_marquardt import levenberg_marquardt
from torchhand.numerics.motion import MotionModel
from torchhand.numerics.polytope import Polytope, polytope
from torchhand.numerics.robust import RobustLoss
from torchhand.numerics.sigma import SigmaPoints, UnscentedSettings, sigma_points
from torchhand.numerics.truncated_normal import (
    log_ndtr,
    log_normal_mass,
    truncated_normal_log_prob,
    truncated_normal_quantile,
)
from torchhand.numerics.unscented import Update, observed_points, predict, predict_linear, update

__all__ = [
    "Gaussian",
    "LeastSquares",
    "LevenbergMarquardtSettings",
    "MotionModel",
    "NormalEquations",
    "Polytope",
    "RobustLoss",
    "SigmaPoints",
    "Status",
    "UnscentedSettings",
    "Update",
    "chi_square_quantile",
    "levenberg_marquardt",
    "log_ndtr",
    "log_normal_mass",
    "mean_chi_square_band",
    "nees",
    "nis",
    "observed_points",
    "polytope",
    "predict",
    "predict_linear",
    "robust_cholesky",
    "sigma_points",
    "truncated_normal_log_prob",
    "truncated_normal_quantile",
    "update",
]
