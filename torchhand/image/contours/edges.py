"""Edges along the normals of a predicted contour."""

import math
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn.functional import conv1d

from torchhand.devices import is_host, kept
from torchhand.image.contours.sampling import is_inside, sample_bilinear

_STEP_PX = 0.5  # distance of samples along the normal
_MOST_IN_BAND = 400  # positions along a normal for which the kernel is kept as a matrix, of 1.3 MB at most


@dataclass(frozen=True, kw_only=True)
class EdgeSettings:
    sigma_px: float = 1.5
    """Standard deviation of the derivative-of-Gaussian kernel; >= 0.5, the distance of samples."""
    min_strength: float = 0.03
    """Weakest edge accepted: height of the step in the picture's own units (0.03 is 8 grey levels of 255)."""
    polarity: Literal["any", "inside_bright", "inside_dark"] = "any"
    """Side of an edge that must be the brighter; inside is where the normal comes from."""
    choose: Literal["strongest", "nearest"] = "strongest"
    """The strongest edge (Stenger et al. 2001), or the one nearest to the predicted point among the rivals."""
    rival_fraction: float = 0.5
    """An edge at least this share as strong as the strongest is its rival; 0..1."""

    def __post_init__(self) -> None:
        if not self.sigma_px >= _STEP_PX:
            raise ValueError(f"EdgeSettings.sigma_px must be >= {_STEP_PX} px, got {self.sigma_px}")
        if not self.min_strength >= 0:
            raise ValueError(f"EdgeSettings.min_strength must be >= 0, got {self.min_strength}")
        if not 0 <= self.rival_fraction <= 1:
            raise ValueError(f"EdgeSettings.rival_fraction must lie in 0..1, got {self.rival_fraction}")
        if self.polarity not in ("any", "inside_bright", "inside_dark"):
            allowed = "any, inside_bright, inside_dark"
            raise ValueError(f"EdgeSettings.polarity must be one of {allowed}, got {self.polarity!r}")
        if self.choose not in ("strongest", "nearest"):
            raise ValueError(f"EdgeSettings.choose must be one of strongest, nearest, got {self.choose!r}")

    def reach_px(self, half_length_px: float) -> float:
        """Distance from a predicted point within which a search reads pixels, px."""
        return half_length_px + 3.0 * self.sigma_px + 2.0 * _STEP_PX


@dataclass(frozen=True, kw_only=True)
class EdgeSearch:
    """One edge per contour point, or none: where `found` is False every other field is 0."""

    offset_px: Float[Tensor, "*batch points"]
    """Signed distance from the predicted point along its normal; the innovation of a filter."""
    strength: Float[Tensor, "*batch points"]
    """Height of the step, in the picture's units, >= 0."""
    polarity: Int[Tensor, "*batch points"]
    """+1 the inside is brighter, -1 the outside is."""
    found: Bool[Tensor, "*batch points"]
    candidates: Int[Tensor, "*batch points"]
    """Number of candidate edges, the chosen one included; above 1 there is clutter and the measurement deserves less
    trust."""


def search_edges(
    image: Float[Tensor, "*channels height width"],
    points_px: Float[Tensor, "*batch points 2"],
    normals: Float[Tensor, "*batch points 2"],
    settings: EdgeSettings | None = None,
    *,
    half_length_px: float | Float[Tensor, "*batch points"] = 15.0,
    channel_weights: Float[Tensor, " channels"] | None = None,
) -> EdgeSearch:
    """Edge nearest the truth along each contour normal (Stenger et al. 2001, section 4.3).

    The picture, one plane (height, width) or several (channels, height, width), is read bilinearly along each unit,
    outward normal and correlated with t/sigma² exp(-t²/2 sigma²), cut off at 3 sigma and scaled so that a step of
    height h that nothing has blurred answers h (blurred by a Gaussian s: h sigma / sqrt(sigma² + s²)). An edge is a
    local maximum of the answer's magnitude, refined by a parabola; the flank of an edge beyond the end of the search is
    none. With several planes the one with the largest weighted answer speaks at each place (a weighted *sum* of planes
    is a search in the summed picture). The picture itself is not smoothed.

    Samples outside the picture are unknown: no edge is found within 3 sigma + 1 px of the border. `half_length_px`: how
    far the search reaches to both sides of the predicted points, of all or of each; 0 finds nothing but an edge at the
    point itself. Offsets are in the dtype of the points. Gradients do not flow.
    """
    settings = EdgeSettings() if settings is None else settings
    planes = image if image.ndim == 3 else image[None]
    if image.ndim not in (2, 3):
        raise ValueError(f"image must be (height, width) or (channels, height, width), got {tuple(image.shape)}")
    if points_px.shape != normals.shape:
        raise ValueError(f"points {tuple(points_px.shape)} and normals {tuple(normals.shape)} must have the same shape")
    with torch.no_grad():
        if isinstance(half_length_px, Tensor):
            reach = float(half_length_px.max()) if half_length_px.numel() else 0.0
        else:
            reach = half_length_px
        reach = min(reach, math.hypot(*planes.shape[-2:]))  # of a hand at the camera's lens it would be without bound
        response, is_valid, offsets = _responses(planes, points_px, normals, settings, reach, channel_weights)
        if isinstance(half_length_px, Tensor):
            is_near = offsets.abs() <= half_length_px[..., None] + 1e-6
            is_valid = is_near if is_valid is None else is_valid & is_near
        return _choose(response, is_valid, offsets, settings, points_px.dtype)


def _responses(
    planes: Tensor, points_px: Tensor, normals: Tensor, settings: EdgeSettings, reach: float, weights: Tensor | None
) -> tuple[Tensor, Tensor | None, Tensor]:
    """Signed answers (*batch, points, positions + 2), which inner ones are known, None for all, and the positions in
    px."""
    half_positions = math.floor(reach / _STEP_PX + 1e-6)
    half_taps = math.ceil(3.0 * settings.sigma_px / _STEP_PX)
    half_samples = half_positions + 1 + half_taps
    samples = _steps(half_samples, points_px.dtype, planes.device)
    # Coordinates apart in memory, as the readers want them.
    start, direction = points_px.movedim(-1, 0)[..., None], normals.movedim(-1, 0)[..., None]
    places = torch.addcmul(start, direction, samples).movedim(0, -1)
    # Profiles are straight and the picture is convex: a stretch is inside when both its ends are.
    height, width = planes.shape[-2:]
    ends = places[..., :: places.shape[-2] - 1, :]
    all_inside = is_host(places.device) and bool(is_inside(ends, width, height).all())
    profile = sample_bilinear(planes, places, all_inside=all_inside)

    response = _correlated(profile, settings.sigma_px, 2 * half_positions + 3)
    if weights is not None:
        response = response * weights.to(response).reshape(-1, *(1,) * (response.ndim - 1))
    if planes.shape[0] == 1:
        response = response[0]
    else:
        loudest = _magnitude(response, settings.polarity).argmax(dim=0, keepdim=True)
        response = response.gather(0, loudest)[0]

    is_valid = None
    if not all_inside:
        inside = is_inside(places, width, height)
        reached = 2 * half_taps + 2
        is_valid = inside[..., : 2 * half_positions + 1] & inside[..., reached:]
    return response, is_valid, samples[half_taps + 1 : half_taps + 2 + 2 * half_positions]


def derivative_of_gaussian(sigma_px: float) -> Float[Tensor, " taps"]:
    """Correlation kernel t/sigma² exp(-t²/2 sigma²), |t| <= 3 sigma, its positive half summing to one; float64."""
    half_taps = math.ceil(3.0 * sigma_px / _STEP_PX)
    t = torch.arange(-half_taps, half_taps + 1, dtype=torch.float64) * _STEP_PX
    kernel = t * torch.exp(-0.5 * (t / sigma_px) ** 2)
    return kernel / kernel[half_taps + 1 :].sum()


@kept(256)
def _steps(count: int, dtype: torch.dtype, device: torch.device) -> Tensor:
    """Places along a profile, px."""
    return torch.arange(-count, count + 1, device=device, dtype=dtype) * _STEP_PX


def _correlated(profile: Tensor, sigma_px: float, positions: int) -> Tensor:
    """Rows of samples (..., positions + taps - 1) correlated with the kernel: by its band matrix where that is small,
    which is the faster."""
    if positions <= _MOST_IN_BAND:
        return profile @ _correlation(sigma_px, positions, profile.dtype, profile.device)
    kernel = derivative_of_gaussian(sigma_px).to(profile)
    return conv1d(profile.flatten(0, -2)[:, None], kernel[None, None]).reshape(*profile.shape[:-1], positions)


@kept(256)
def _correlation(sigma_px: float, positions: int, dtype: torch.dtype, device: torch.device) -> Tensor:
    """Band matrix of the kernel; a tracker asks for the same few again and again."""
    return _band(derivative_of_gaussian(sigma_px), positions).to(dtype=dtype, device=device)


def _band(kernel: Tensor, positions: int) -> Tensor:
    """Matrix (positions + taps - 1, positions): a row of samples times it is its correlation with the kernel."""
    taps = kernel.numel()
    band = kernel.new_zeros(positions + taps - 1, positions)
    for tap in range(taps):
        band.diagonal(-tap).copy_(kernel[tap].expand(positions))
    return band


def _magnitude(response: Tensor, polarity: str) -> Tensor:
    if polarity == "any":
        return response.abs()
    return -response if polarity == "inside_bright" else response


def _choose(
    response: Tensor, may_be_edge: Tensor | None, offsets: Tensor, settings: EdgeSettings, dtype: torch.dtype
) -> EdgeSearch:
    magnitude = _magnitude(response, settings.polarity)
    before, here, after = magnitude[..., :-2], magnitude[..., 1:-1], magnitude[..., 2:]
    is_peak = (here > before) & (here >= after) & (here >= settings.min_strength)
    if may_be_edge is not None:
        is_peak = is_peak & may_be_edge
    heights = torch.where(is_peak, here, -1.0)
    if settings.choose == "nearest":
        strongest = heights.amax(-1, keepdim=True)
        is_rival = heights >= settings.rival_fraction * strongest.clamp_min(0.0)
        index = torch.where(is_rival, offsets.abs(), torch.inf).argmin(dim=-1, keepdim=True)
    else:
        strongest, index = heights.max(dim=-1, keepdim=True)
        is_rival = heights >= settings.rival_fraction * strongest.clamp_min(0.0)
    found = strongest[..., 0] >= 0

    a, b, c = (part.gather(-1, index)[..., 0] for part in (before, here, after))
    curvature = torch.where(found, a - 2.0 * b + c, -1.0)
    shift = (0.5 * (a - c) / curvature).clamp(-0.5, 0.5) * _STEP_PX
    place = offsets[index[..., 0]] + shift.to(dtype)
    sign = -response[..., 1:-1].gather(-1, index)[..., 0].sign()
    return EdgeSearch(
        offset_px=torch.where(found, place.to(dtype), 0.0),
        strength=torch.where(found, b, 0.0),
        polarity=torch.where(found, sign, 0.0).to(torch.int64),
        found=found,
        candidates=is_rival.sum(dim=-1),
    )
