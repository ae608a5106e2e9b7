"""The open hand in a photograph of any size: found in the whole of it, cut out, and fitted at a bounded size."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, UInt8
from torch import Tensor

from torchhand.geometry import Camera
from torchhand.image import PicturePart, find_open_hand
from torchhand.image.fingers import HandSilhouette

_MAX_PIXELS = 640 * 480
"""The size of the pictures with which the search was measured; a hand that fills it is resolved to 0.3 mm."""
_FINER = 1.2  # times the resolution, from which on cutting out is worth a second search
_MIN_ALIKE = 0.9  # overlap of the hand that is found in the part with that in the whole


@dataclass(frozen=True, kw_only=True)
class HandInPicture:
    """The silhouette of a hand in a picture's part."""

    part: PicturePart
    silhouette: HandSilhouette

    def camera(self, whole: Camera) -> Camera:
        """The camera of the part, of that of the whole picture."""
        return whole.of_part(self.part.corner, self.part.part, self.part.size)


def hand_in_picture(
    image: UInt8[Tensor, "height width 3"], mask: Bool[Tensor, "height width"] | None = None
) -> HandInPicture:
    """The open hand, in the part of the picture that holds it; in the whole where that is small enough.

    mask: its silhouette where that is known.
    """
    height, width = int(image.shape[0]), int(image.shape[1])
    whole = PicturePart.of((0, 0), (width, height), _MAX_PIXELS)
    if mask is not None:
        found = HandSilhouette(mask=whole.mask(mask), source="given", search=None, edge_fraction=0.0)
    else:
        found = find_open_hand(whole.image(image))
    first = HandInPicture(part=whole, silhouette=found)
    if whole.size == whole.part or not bool(found.mask.any()):
        return first
    part = PicturePart.about(found.mask, whole, _MAX_PIXELS)
    if part.scale < _FINER * whole.scale:
        return first
    if mask is not None:
        found = HandSilhouette(mask=part.mask(mask), source="given", search=None, edge_fraction=0.0)
        return HandInPicture(part=part, silhouette=found)
    closer = HandInPicture(part=part, silhouette=find_open_hand(part.image(image)))
    return closer if _alike(first, closer) else first


def _alike(first: HandInPicture, closer: HandInPicture) -> bool:
    """Whether both are the same hand, compared in the pixels of the first."""
    whole, part = first.part, closer.part
    scale = tuple(part.size[axis] / part.part[axis] for axis in range(2))
    x, y = (
        ((torch.arange(whole.size[axis]) + 0.5) * whole.part[axis] / whole.size[axis] - part.corner[axis]) * scale[axis]
        for axis in range(2)
    )
    columns, rows = x.long().clamp(0, part.size[0] - 1), y.long().clamp(0, part.size[1] - 1)
    is_inside = ((y >= 0) & (y < part.size[1]))[:, None] & ((x >= 0) & (x < part.size[0]))
    again = closer.silhouette.mask[rows][:, columns] & is_inside
    both, either = (again & first.silhouette.mask).sum(), (again | first.silhouette.mask).sum()
    return bool(both >= _MIN_ALIKE * either)
