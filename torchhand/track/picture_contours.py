"""What registration keeps of a picture: its contour as distance maps from coarse to fine and as points, its valleys."""

import math
from dataclasses import dataclass

from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from torchhand.image.distance_fields import Boundary, DistanceField, boundary_field, boundary_points, point_field
from torchhand.image.valleys import find_valleys
from torchhand.track.registration_settings import RegistrationSettings

_CELLS = 32  # a map is no coarser than the silhouette's size (root of its area) over so many cells
_FEWEST = 16  # points of a contour
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
    finest = max(1, math.floor(math.sqrt(float(mask.sum())) / _CELLS))
    made: dict[int, DistanceField] = {}
    fields = []
    for level in settings.levels:
        pitch = min(level.pitch_px, finest)
        if pitch not in made:
            made[pitch] = boundary_field(mask, pitch_px=pitch, channels=settings.directions, ignored=ignored)
        fields.append(made[pitch])
    valleys = None
    if image is not None and settings.valley_weight > 0:
        found = find_valleys(_grey(image), settings.valleys, within=mask)
        if len(found.points_px):
            height, width = mask.shape
            valleys = point_field(found.points_px, width, height, pitch_px=_VALLEY_PITCH)
    return PictureContours(
        fields=tuple(fields),
        boundary=boundary_points(mask, settings.boundary_points, ignored=ignored),
        valleys=valleys,
    )


def _grey(image: Tensor) -> Float[Tensor, "height width"]:
    if image.ndim == 2:
        return image
    red, green, blue = image.float().unbind(-1)
    return _GREY[0] * red + _GREY[1] * green + _GREY[2] * blue
