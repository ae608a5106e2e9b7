"""What registration keeps of a picture: its contour as distance maps from coarse to fine and as points, its valleys."""

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from torchhand.fit.contour.settings import RegistrationSettings
from torchhand.image import Boundary, DistanceField, boundary_field, boundary_points, find_valleys, point_field
from torchhand.image.contours import Window, valley_reach

_CELLS = 32  # a map is no coarser than the silhouette's size (root of its area) over so many cells
_FEWEST = 16  # points of a contour
_REACH = 3.0  # maps go so many robust distances beyond the contour's box; what is farther away hardly counts
_VALLEY_PITCH = 0.5  # px
_GREY = (0.299, 0.587, 0.114)  # of red, green, blue


@dataclass(frozen=True, kw_only=True)
class PictureContours:
    """The contours of the hand in one picture."""

    fields: tuple[DistanceField, ...]
    """Signed distance from the outer contour, one per level."""
    boundary: Boundary
    """Points of the outer contour."""
    valleys: DistanceField | None
    """Distance from the inner dark lines; None where there are none or they are left out."""

    @property
    def is_empty(self) -> bool:
        """Too little contour to register on."""
        return len(self.boundary.points_px) < _FEWEST


def picture_contours(
    mask: Bool[Tensor, "height width"],
    settings: RegistrationSettings | None = None,
    *,
    image: UInt8[Tensor, "height width 3"] | Float[Tensor, "height width"] | None = None,
    ignored: Bool[Tensor, "height width"] | None = None,
) -> PictureContours:
    """Contours of a silhouette, and valleys within it where the picture is given, RGB or grey levels.

    ignored: where the silhouette's boundary is none of the hand, such as where a forearm was cut off, or a sleeve. The
    picture's edge is no boundary anyway. An empty silhouette gives empty contours.
    """
    settings = settings or RegistrationSettings()
    window = Window.around(mask.cpu().numpy(), valley_reach(settings.valleys))
    size_px = math.hypot(window.right - window.left, window.bottom - window.top)
    finest = max(1, math.floor(math.sqrt(float(mask.sum())) / _CELLS))
    pitches = [min(level.pitch_px, finest) for level in settings.levels]
    reaches: dict[int, float] = {}
    for pitch, level in zip(pitches, settings.levels, strict=True):
        reaches[pitch] = max(reaches.get(pitch, 0.0), _REACH * level.robust_share * size_px)
    made = {
        pitch: boundary_field(mask, pitch_px=pitch, channels=settings.directions, ignored=ignored, reach_px=reach)
        for pitch, reach in reaches.items()
    }
    valleys = None
    if image is not None and settings.valley_weight > 0:
        valleys = _valleys(image, mask, window, settings)
    return PictureContours(
        fields=tuple(made[pitch] for pitch in pitches),
        boundary=boundary_points(mask, settings.boundary_points, ignored=ignored),
        valleys=valleys,
    )


def _valleys(image: Tensor, mask: Tensor, window: Window, settings: RegistrationSettings) -> DistanceField | None:
    """Distance from the valleys within the silhouette, found in the window around it."""
    found = find_valleys(_grey(image[window.slices]), settings.valleys, within=mask[window.slices])
    if not len(found.points_px):
        return None
    width, height = window.right - window.left, window.bottom - window.top
    field = point_field(found.points_px, width, height, pitch_px=_VALLEY_PITCH)
    x, y = field.origin_px
    return replace(field, origin_px=(x + window.left, y + window.top))


def _grey(image: Tensor) -> Float[Tensor, "height width"]:
    if image.ndim == 2:
        return image
    return image.float() @ torch.tensor(_GREY, device=image.device)
