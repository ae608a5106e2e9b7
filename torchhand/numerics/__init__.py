"""Estimators on tensors, batched over independent problems: they know no hand and no image."""

from torchhand.numerics.adaptive import (
    AdaptiveNoiseSettings,
    adapted_covariance,
    adapted_variance,
    gain_covariance,
    noise_density,
    process_covariance,
    residual_covariance,
    residual_variance,
)
from torchhand.numerics.box import mode_in_box
from torchhand.numerics.cholesky import robust_cholesky
from torchhand.numerics.consistency import chi_square_quantile, mean_chi_square_band, nees, nis
from torchhand.numerics.descent import DescentSettings, gradient_descent
from torchhand.numerics.extended import Linearised, linearised, predict_extended, predict_motion, update_extended
from torchhand.numerics.gaussian import Gaussian
from torchhand.numerics.iterated import IteratedSettings, IteratedUpdate, update_iterated
from torchhand.numerics.least_squares import LeastSquares, LevenbergMarquardtSettings, NormalEquations, Status
from torchhand.numerics.levenberg_marquardt import levenberg_marquardt
from torchhand.numerics.motion import MotionModel
from torchhand.numerics.polytope import Polytope, polytope
from torchhand.numerics.robust import RobustLoss
from torchhand.numerics.sigma import SigmaPoints, UnscentedSettings, sigma_points
from torchhand.numerics.single_thread import single_threaded
from torchhand.numerics.truncated_normal import (
    log_ndtr,
    log_normal_mass,
    truncated_normal_log_prob,
    truncated_normal_quantile,
)
from torchhand.numerics.unscented import Update, observed_points, predict, predict_linear, update
from torchhand.numerics.whitening import wrapped

__all__ = [
    "AdaptiveNoiseSettings",
    "DescentSettings",
    "Gaussian",
    "IteratedSettings",
    "IteratedUpdate",
    "LeastSquares",
    "LevenbergMarquardtSettings",
    "Linearised",
    "MotionModel",
    "NormalEquations",
    "Polytope",
    "RobustLoss",
    "SigmaPoints",
    "Status",
    "UnscentedSettings",
    "Update",
    "adapted_covariance",
    "adapted_variance",
    "chi_square_quantile",
    "gain_covariance",
    "gradient_descent",
    "levenberg_marquardt",
    "linearised",
    "log_ndtr",
    "log_normal_mass",
    "mean_chi_square_band",
    "mode_in_box",
    "nees",
    "nis",
    "noise_density",
    "observed_points",
    "polytope",
    "predict",
    "predict_extended",
    "predict_linear",
    "predict_motion",
    "process_covariance",
    "residual_covariance",
    "residual_variance",
    "robust_cholesky",
    "sigma_points",
    "single_threaded",
    "truncated_normal_log_prob",
    "truncated_normal_quantile",
    "update",
    "update_extended",
    "update_iterated",
    "wrapped",
]
