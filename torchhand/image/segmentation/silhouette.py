"""One clean mask of the hand per frame, by skin colour, against a known background, or before a coloured screen."""

import math
from dataclasses import dataclass
from typing import Literal

import cv2
import torch
from jaxtyping import Bool, UInt8
from torch import Tensor

from torchhand.image.operations import disc_kernel, opened
from torchhand.image.segmentation.background import BackgroundPlate, background_mask, chroma_mask
from torchhand.image.segmentation.components import clean, fill_holes, largest_component
from torchhand.image.segmentation.light import Light
from torchhand.image.segmentation.skin import SkinModel, hue_probability_u8, with_dark_u8

_SHADED = 0.7  # of the least probability of skin: what is enough beside lit skin, of a hue that was hardly seen
_DARKEST = 16  # largest channel below which hue means nothing
_RIM = 200  # as a share of the picture's longer side, half the width of a rim of wrong hue beside skin


@dataclass(frozen=True, kw_only=True)
class SilhouetteSettings:
    method: Literal["skin", "background", "chroma"] = "skin"
    """Method of the segmentation: by a skin model, by a plate of the empty scene, or by the hue of a coloured
    screen."""
    skin_threshold: float = 0.5
    """Least probability of skin; between 0 and 1."""
    shaded_skin: float = 1.0
    """Brightness down to which patches of skin's hue are skin in the shade, as a share of the skin model's dark value;
    0..1, 1 believes in none. Rims of that hue, which coarse colour coding leaves beside skin, are no patches."""
    background_threshold: float = 6.0
    """Difference from the plate, in standard deviations of its noise; > 0."""
    darkest_shadow: float = 0.5
    """Factor of brightness down to which a darker background is a shadow; 0..1, 1 forgives none."""
    key_hue_deg: float = 240.0
    """Hue of the screen: 120 green, 240 blue; 0..360."""
    key_tolerance_deg: float = 25.0
    """Hues so near the key belong to the screen; between 0 and 180."""
    clean_radius_px: int | None = None
    """Radius of opening and closing; none: 1 px per 320 px of the longer side, 0: no cleaning."""
    max_hole_fraction: float = 0.002
    """Holes up to this share of the picture are filled (a nail, a glint), larger ones stay; 0..1."""
    largest_only: bool = True
    """Keep the largest piece alone."""
    max_side_px: int = 640
    """Larger pictures are reduced to this longer side for the work; the mask is of full size; >= 16."""

    def __post_init__(self) -> None:
        if self.method not in ("skin", "background", "chroma"):
            allowed = "skin, background, chroma"
            raise ValueError(f"SilhouetteSettings.method must be one of {allowed}, got {self.method!r}")
        bounds = {
            "skin_threshold": (0.0, 1.0),
            "shaded_skin": (0.0, 1.0),
            "darkest_shadow": (0.01, 1.0),
            "key_hue_deg": (0.0, 360.0),
            "max_hole_fraction": (0.0, 1.0),
        }
        for name, (low, high) in bounds.items():
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"SilhouetteSettings.{name} must lie in {low:g}..{high:g}, got {getattr(self, name)}")
        if not self.background_threshold > 0:
            raise ValueError(f"SilhouetteSettings.background_threshold must be > 0, got {self.background_threshold}")
        if not 0 < self.key_tolerance_deg < 180:
            got = self.key_tolerance_deg
            raise ValueError(f"SilhouetteSettings.key_tolerance_deg must lie between 0 and 180, got {got}")
        if self.clean_radius_px is not None and self.clean_radius_px < 0:
            raise ValueError(f"SilhouetteSettings.clean_radius_px must be >= 0 or none, got {self.clean_radius_px}")
        if self.max_side_px < 16:
            raise ValueError(f"SilhouetteSettings.max_side_px must be >= 16, got {self.max_side_px}")


def segment(
    image: UInt8[Tensor, "height width 3"],
    settings: SilhouetteSettings | None = None,
    *,
    skin: SkinModel | None = None,
    plate: BackgroundPlate | None = None,
) -> Bool[Tensor, "height width"]:
    """Mask of the hand (and bare forearm): pixels by `settings.method`, cleaned, the largest piece, holes filled.

    `skin` is needed by the method "skin", `plate` by "background". The mask may be empty; it is never an error.
    """
    settings = SilhouetteSettings() if settings is None else settings
    height, width = image.shape[:2]
    scale = min(1.0, settings.max_side_px / max(height, width))
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    if scale < 1.0:
        image = _resized(image, size)
        plate = None if plate is None else _reduced_plate(plate, size)
    mask = clean(_foreground(image, settings, skin, plate), settings.clean_radius_px)
    if settings.largest_only:
        mask = largest_component(mask)
    mask = fill_holes(mask, max_area=int(settings.max_hole_fraction * mask.numel()))
    if scale == 1.0:
        return mask
    return _resized(mask.to(torch.uint8) * 255, (width, height)) > 127


def _foreground(
    image: Tensor, settings: SilhouetteSettings, skin: SkinModel | None, plate: BackgroundPlate | None
) -> Tensor:
    if settings.method == "chroma":
        return chroma_mask(image, settings.key_hue_deg, tolerance_deg=settings.key_tolerance_deg)
    if settings.method == "background":
        if plate is None:
            raise ValueError("segment by background needs plate=learn_background(frames of the empty scene)")
        seen = Light.of(plate.colour).undone(image)  # a camera that finds its exposure anew changes all the picture
        return background_mask(
            seen, plate, threshold=settings.background_threshold, darkest_shadow=settings.darkest_shadow
        )
    if skin is None:
        raise ValueError("segment by skin needs skin=learn_skin(...) or bootstrap_skin(image).model")
    return _skin_pixels(image, settings, skin)


def _skin_pixels(image: Tensor, settings: SilhouetteSettings, skin: SkinModel) -> Tensor:
    """What is lit as the skin that the model learned, and patches of its hue that are in the shade."""
    found, value = hue_probability_u8(image, skin)
    floor = 255.0 * settings.skin_threshold
    mask = torch.from_numpy(with_dark_u8(found, value, skin) > math.floor(floor))
    if settings.shaded_skin < 1.0:
        darkest = max(_DARKEST, settings.shaded_skin * skin.dark_value)
        is_dim = (value < skin.dark_value) & (value >= darkest)
        shaded = is_dim & (found > math.floor(_SHADED * floor))
        mask |= opened(torch.from_numpy(shaded), disc_kernel(max(1, round(max(shaded.shape) / _RIM))))
    return mask.to(image.device)


def _resized(picture: Tensor, size: tuple[int, int]) -> Tensor:
    pixels = cv2.resize(picture.cpu().contiguous().numpy(), size, interpolation=cv2.INTER_LINEAR)
    return torch.from_numpy(pixels).to(picture.device)


def _reduced_plate(plate: BackgroundPlate, size: tuple[int, int]) -> BackgroundPlate:
    return BackgroundPlate(colour=_resized(plate.colour, size), noise=_resized(plate.noise, size))
