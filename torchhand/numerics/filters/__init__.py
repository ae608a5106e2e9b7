"""Gaussian filters over a state, batched: unscented, extended and iterated, with gates, adaption and consistency."""

from torchhand.numerics.filters.adaptive import (
    AdaptiveNoiseSettings,
    adapted_variance,
    gain_covariance,
    noise_density,
    process_covariance,
)
from torchhand.numerics.filters.cholesky import robust_cholesky
from torchhand.numerics.filters.conditioning import with_marginal
from torchhand.numerics.filters.consistency import chi_square_quantile, mean_chi_square_band, nees, nis
from torchhand.numerics.filters.extended import (
    Linearised,
    update_extended,
)
from torchhand.numerics.filters.gaussian import Gaussian, Measurement
from torchhand.numerics.filters.information import update_quadratic
from torchhand.numerics.filters.iterated import IteratedSettings, IteratedUpdate, update_iterated
from torchhand.numerics.filters.motion import MotionModel
from torchhand.numerics.filters.sigma import SigmaPoints, UnscentedSettings, sigma_points
from torchhand.numerics.filters.unscented import Update, observed_points, predict, predict_linear, update
from torchhand.numerics.filters.whitening import wrapped

__all__ = [
    "AdaptiveNoiseSettings",
    "Gaussian",
    "IteratedSettings",
    "IteratedUpdate",
    "Linearised",
    "Measurement",
    "MotionModel",
    "SigmaPoints",
    "UnscentedSettings",
    "Update",
    "adapted_variance",
    "chi_square_quantile",
    "gain_covariance",
    "mean_chi_square_band",
    "nees",
    "nis",
    "noise_density",
    "observed_points",
    "predict",
    "predict_linear",
    "process_covariance",
    "robust_cholesky",
    "sigma_points",
    "update",
    "update_extended",
    "update_iterated",
    "update_quadratic",
    "with_marginal",
    "wrapped",
]
