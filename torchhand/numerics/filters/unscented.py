"""The unscented Kalman filter, batched over independent filters, for many measurements with independent noise."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.numerics.filters.cholesky import robust_cholesky, semidefinite
from torchhand.numerics.filters.gaussian import Gaussian, Measurement
from torchhand.numerics.filters.information import correct, is_bearable_centre
from torchhand.numerics.filters.sigma import UnscentedSettings, Weights, sigma_points, spread_points
from torchhand.numerics.filters.whitening import is_countable, is_full, usable
from torchhand.precision import full_precision

DEFAULT_SETTINGS = UnscentedSettings()


@dataclass(frozen=True, kw_only=True)
class Update:
    """Result of a measurement update. A measurement that cannot be used has innovation 0 and infinite variance."""

    state: Gaussian  # the posterior
    innovation: Float[Tensor, "*batch m"]  # measurement minus its prediction, gated ones included
    innovation_variance: Float[Tensor, "*batch m"]  # diagonal of S, the covariance of the innovation
    used: Bool[Tensor, "*batch m"]  # valid, finite and inside the gate
    nis: Float[Tensor, "*batch"]  # normalised innovation squared of the used measurements; chi-square of `count`
    count: Int[Tensor, "*batch"]  # number of used measurements


@dataclass(frozen=True, kw_only=True)
class _Spread:
    """Square roots of the joint covariance of state and predicted measurement; see `information.correct`."""

    predicted: Tensor  # (*batch, m) mean of the predicted measurement
    rows: Tensor  # (*batch, p, m) Eᵀ, the centre first
    centre_sign: float
    state: Tensor  # (*batch, n, a) A
    remainder: Tensor | None  # (*batch, n, n) P - A J Aᵀ; None for zero


@full_precision
def predict(
    state: Gaussian,
    transition: Callable[[Tensor], Tensor],
    process_noise: Float[Tensor, "*#batch n n"],
    settings: UnscentedSettings = DEFAULT_SETTINGS,
) -> Gaussian:
    """Time update through a nonlinear `transition` of states (*batch, p, n) -> (*batch, p, n).

    `update` draws new points from the result, so the process noise reaches the gain.
    """
    weights = Weights.of(settings, state.mean.shape[-1])
    points = sigma_points(state, settings).points
    moved = transition(points)
    _require_shape("transition", moved, points.shape)
    mean, rows, sign = _transform(moved, weights)
    covariance = rows[..., 1:, :].mT @ rows[..., 1:, :] + sign * rows[..., :1, :].mT @ rows[..., :1, :] + process_noise
    return Gaussian(mean, semidefinite(_symmetric(covariance)))


@full_precision
def predict_linear(
    state: Gaussian, transition: Float[Tensor, "*#batch n n"], process_noise: Float[Tensor, "*#batch n n"]
) -> Gaussian:
    """Time update of a linear model, exact: mean F x and covariance F P Fᵀ + Q, which rounding makes no other thing."""
    mean = (transition @ state.mean.unsqueeze(-1)).squeeze(-1)
    moved = transition @ state.covariance @ transition.mT
    return Gaussian(mean, semidefinite(_symmetric(moved + process_noise)))


@full_precision
def update(
    state: Gaussian,
    observe: Callable[[Tensor], Tensor],
    measurement: Measurement,
    settings: UnscentedSettings = DEFAULT_SETTINGS,
    *,
    gate: float | None = None,
    observed: int | None = None,
    points: Float[Tensor, "*batch p n"] | None = None,
) -> Update:
    """Measurement update: x + K ν and P - K S Kᵀ with the unscented K and S, in information form (Woodbury).

    observe    maps states (*batch, p, k) to measurements (*batch, p, m), k = n or `observed`; any nonlinearity
    measurement with variances, as noises are independent. One that is not finite, or whose prediction is not, or that
               is too far from it for the square of the distance, is left out as well
    gate       leaves out each measurement with ν² > gate * S_jj, for example 9 for three sigma
    observed   `observe` depends on the first k components only and is given only those, at 2k + 1 instead of 2n + 1
               points: offsets are columns of a lower triangular factor, so all other points look like the centre
    points     2n + 1 states to use in place of a fresh draw, in the order of `sigma_points`

    A filter without any used measurement comes back unchanged. Where a centre of negative weight would leave no
    covariance of the innovation, it is left out. Cost: O(m p² + p³), p the number of points.
    """
    if gate is not None and not gate > 0:
        raise ValueError(f"gate must be None or above 0, got {gate!r}")
    size, variance = measurement.value.shape[-1], measurement.noise
    if is_full(variance, measurement.value):
        raise ValueError(f"noise: expected variances of independent noises, got covariances {tuple(variance.shape)}")
    if points is None:
        spread = _spread_of_draw(state, observe, settings, observed, size)
    elif observed is not None:
        raise ValueError("observed needs freshly drawn points, got both observed and points")
    else:
        spread = _spread_of_points(state, observe, settings, points, size)

    rows, innovation = spread.rows, measurement.value - spread.predicted
    used = usable(innovation, measurement.valid)
    if not bool(((variance > 0) | ~used).all()):
        raise ValueError("variance must be above 0 wherever a measurement is valid, got 0, a negative number or NaN")
    used = used & is_countable(innovation, variance)
    # Here, where everything is linear, so that a NaN spoils no gradient either.
    rows = torch.where(used.unsqueeze(-2), rows, 0.0)
    innovation = torch.where(used, innovation, 0.0)
    variance = torch.where(used, variance, torch.inf)
    if spread.centre_sign < 0:
        is_kept = is_bearable_centre(rows * variance.rsqrt().unsqueeze(-2))
        rows = torch.cat((torch.where(is_kept[..., None, None], rows[..., :1, :], 0.0), rows[..., 1:, :]), -2)
    squares = rows.square()
    innovation_variance = variance + squares[..., 1:, :].sum(-2) + spread.centre_sign * squares[..., 0, :]
    if gate is not None:
        used = used & (innovation.square() <= gate * innovation_variance)
    precision_root = torch.where(used, variance, torch.inf).rsqrt()
    correction = correct(
        spread.state, rows * precision_root.unsqueeze(-2), innovation * precision_root, spread.centre_sign
    )

    covariance = correction.covariance
    if spread.remainder is not None:
        covariance = covariance + spread.remainder
    count = used.sum(-1)
    has_any = (count > 0).unsqueeze(-1)
    posterior = Gaussian(
        torch.where(has_any, state.mean + correction.shift, state.mean),
        torch.where(has_any.unsqueeze(-1), _symmetric(covariance), state.covariance),
    )
    return Update(
        state=posterior,
        innovation=innovation,
        innovation_variance=innovation_variance,
        used=used,
        nis=correction.nis,
        count=count,
    )


@full_precision
def observed_points(
    state: Gaussian, settings: UnscentedSettings, observed: int | None = None
) -> Float[Tensor, "*batch p k"]:
    """The states at which `update` with the same `observed` calls `observe`, for who has other use of them as well."""
    size = state.mean.shape[-1]
    seen = size if observed is None else observed
    factor = robust_cholesky(state.covariance)[..., :seen, :seen]
    return spread_points(state.mean[..., :seen], Weights.of(settings, size).spread * factor)


def _spread_of_draw(
    state: Gaussian, observe: Callable[[Tensor], Tensor], settings: UnscentedSettings, observed: int | None, m: int
) -> _Spread:
    """Observe a fresh symmetric draw and rotate its pairs into sums and differences.

    Only differences correlate with the state, with the columns of the Cholesky factor themselves as square root.
    """
    size = state.mean.shape[-1]
    seen = size if observed is None else observed
    if not 1 <= seen <= size:
        raise ValueError(f"observed must be None or 1 to {size}, got {observed!r}")
    weights = Weights.of(settings, size)
    factor = robust_cholesky(state.covariance)
    points = spread_points(state.mean[..., :seen], weights.spread * factor[..., :seen, :seen])
    values = observe(points)
    _require_shape("observe", values, (*points.shape[:-1], m))
    predicted, rows, sign = _transform(values, weights, hidden=2 * (size - seen))
    plus, minus = rows[..., 1 : seen + 1, :], rows[..., seen + 1 :, :]
    rows = torch.cat([rows[..., :1, :], (plus + minus) * math.sqrt(0.5), (plus - minus) * math.sqrt(0.5)], dim=-2)

    ratio = weights.covariance_ratio
    seen_factor, hidden_factor = factor[..., :seen], factor[..., seen:]
    remainder = None if seen == size else hidden_factor @ hidden_factor.mT
    if not weights.is_exact:
        missing = (1.0 - ratio) * seen_factor @ seen_factor.mT
        remainder = missing if remainder is None else remainder + missing
    return _Spread(
        predicted=predicted,
        rows=rows,
        centre_sign=sign,
        state=seen_factor if weights.is_exact else math.sqrt(ratio) * seen_factor,
        remainder=remainder,
    )


def _spread_of_points(
    state: Gaussian, observe: Callable[[Tensor], Tensor], settings: UnscentedSettings, points: Tensor, m: int
) -> _Spread:
    """Observe points that need be neither symmetric nor spread as the prior."""
    size = state.mean.shape[-1]
    if points.shape[-2] != 2 * size + 1:
        raise ValueError(f"points must be {2 * size + 1} for a state of {size} numbers, got {points.shape[-2]}")
    weights = Weights.of(settings, size)
    values = observe(points)
    _require_shape("observe", values, (*points.shape[:-1], m))
    predicted = values[..., 0, :] + weights.outer * (values[..., 1:, :] - values[..., :1, :]).sum(-2)
    roots = points.new_full((points.shape[-2], 1), math.sqrt(weights.outer))
    roots[0] = math.sqrt(abs(weights.centre_covariance))
    sign = -1.0 if weights.centre_covariance < 0 else 1.0
    spread = ((points - state.mean.unsqueeze(-2)) * roots).mT
    signs = torch.ones_like(roots[:, 0])
    signs[0] = sign
    return _Spread(
        predicted=predicted,
        rows=(values - predicted.unsqueeze(-2)) * roots,
        centre_sign=sign,
        state=spread,
        remainder=semidefinite(_symmetric(state.covariance - (spread * signs) @ spread.mT)),
    )


def _transform(values: Tensor, weights: Weights, hidden: int = 0) -> tuple[Tensor, Tensor, float]:
    """Mean of the transformed points (*batch, p, m), and rows E with covariance EᵀJE, J = diag(sign, 1, ..., 1).

    Works from differences D to the centre, which loses no digits for a small alpha. With d = Σ w D the mean is the
    centre's value plus d, and the covariance is both of

        Σ w (D - d)(D - d)ᵀ + w0 d dᵀ   and   Σ w D Dᵀ + (Σ w + w0 - 2) d dᵀ,

    w0 the centre's weight in covariances. The second is taken where its last weight is not negative (for the scaled
    set: beta >= alpha²), which makes J the identity. `hidden` more points, not given, have the value of the centre.
    """
    outer = values.shape[-2] - 1
    centre = values[..., :1, :]
    rows = values[..., 1:, :] - centre
    shift = weights.outer * rows.sum(-2, keepdim=True)
    weight = (outer + hidden) * weights.outer + weights.centre_covariance - 2.0
    if weight < 0:
        rows = rows - shift
        weight = weights.centre_covariance + hidden * weights.outer
    sign = -1.0 if weight < 0 else 1.0
    rows = torch.cat([shift * math.sqrt(abs(weight)), rows * math.sqrt(weights.outer)], dim=-2)
    return (centre + shift).squeeze(-2), rows, sign


def _symmetric(matrix: Tensor) -> Tensor:
    return 0.5 * (matrix + matrix.mT)


def _require_shape(name: str, values: Tensor, shape: tuple[int, ...]) -> None:
    if tuple(values.shape) != tuple(shape):
        raise ValueError(f"{name} must return shape {tuple(shape)}, got {tuple(values.shape)}")
