"""What is kept of a picture to compare contours with: distance maps from coarse to fine, points, and valleys."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from torchhand.fit import Schedule
from torchhand.fit.contour.settings import ContourSettings
from torchhand.image import Boundary, DistanceField, boundary_field, boundary_points, find_valleys, point_field
from torchhand.image.contours import VALLEY_REACH_PX, Window

_CELLS = 32  # a map is no coarser than the silhouette's size (root of its area) over so many cells
_MIN_POINTS = 16  # points of a contour
_REACH = 3.0  # maps go so many gross distances beyond the contour's box; what is farther away hardly counts
_LENGTH = 0.187  # metres: for the reach of the maps, the silhouette's box is taken to be as long as a mean hand
_VALLEY_PITCH = 0.5  # px
_GREY = (0.299, 0.587, 0.114)  # of red, green, blue


@dataclass(frozen=True, kw_only=True)
class PictureContours:
    """The contours of the hand in one picture."""

    fields: Mapping[int, DistanceField]
    """Signed distance from the outer contour, by the pixels of the picture that one of the map stands for."""
    boundary: Boundary
    """Points of the outer contour."""
    valleys: DistanceField | None
    """Distance from the inner dark lines; None where there are none or they are left out."""

    @property
    def is_empty(self) -> bool:
        """Whether there is too little contour to compare a hand with."""
        return len(self.boundary.points_px) < _MIN_POINTS

    def field(self, pitch_px: int) -> DistanceField:
        """The map of a pitch; of a small hand, the coarsest one that there is up to that.

        Raises ValueError where the maps were made for coarser pitches only.
        """
        pitches = [pitch for pitch in self.fields if pitch <= pitch_px]
        if not pitches:
            raise ValueError(f"pitch_px: expected one of the picture's, {min(self.fields)} or more, got {pitch_px}")
        return self.fields[max(pitches)]


def picture_contours(
    mask: Bool[Tensor, "height width"],
    schedule: Schedule,
    settings: ContourSettings | None = None,
    *,
    image: UInt8[Tensor, "height width 3"] | Float[Tensor, "height width"] | None = None,
) -> PictureContours:
    """Contours of a silhouette, and valleys within it where the picture is given, RGB or grey levels.

    schedule: whose maps are wanted. The picture's edge is no boundary. An empty silhouette gives empty contours.
    """
    settings = settings or ContourSettings()
    window = Window.around(mask.cpu().numpy(), VALLEY_REACH_PX)
    size_px = math.hypot(window.right - window.left, window.bottom - window.top)
    finest = max(1, math.floor(math.sqrt(float(mask.sum())) / _CELLS))
    reaches: dict[int, float] = {}
    for stage in schedule:
        pitch = min(stage.pitch_px, finest)
        reaches[pitch] = max(reaches.get(pitch, 0.0), _REACH * stage.gross_m / _LENGTH * size_px)
    valleys = None
    if image is not None and settings.valley_weight > 0:
        valleys = _valleys(image, mask, window)
    return PictureContours(
        fields={
            pitch: boundary_field(mask, pitch_px=pitch, channels=settings.directions, reach_px=reach)
            for pitch, reach in reaches.items()
        },
        boundary=boundary_points(mask, settings.boundary_points),
        valleys=valleys,
    )


def _valleys(image: Tensor, mask: Tensor, window: Window) -> DistanceField | None:
    """Distance from the valleys within the silhouette, found in the window around it."""
    found = find_valleys(_grey(image[window.slices]), within=mask[window.slices])
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
