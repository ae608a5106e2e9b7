"""Estimators on tensors, batched over independent problems: they know no hand and no image."""

from torchhand.numerics.cholesky import robust_cholesky
from torchhand.numerics.consistency import chi_square_quantile, mean_chi_square_band, nees, nis
from torchhand.numerics.gaussian import Gaussian
from torchhand.numerics.motion import MotionModel
from torchhand.numerics.sigma import SigmaPoints, UnscentedSettings, sigma_points
from torchhand.numerics.unscented import Update, observed_points, predict, predict_linear, update

__all__ = [
    "Gaussian",
    "MotionModel",
    "SigmaPoints",
    "UnscentedSettings",
    "Update",
    "chi_square_quantile",
    "mean_chi_square_band",
    "nees",
    "nis",
    "observed_points",
    "predict",
    "predict_linear",
    "robust_cholesky",
    "sigma_points",
    "update",
]
