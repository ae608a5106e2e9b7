"""The hand's silhouette in every view, without the lens's distortion: given, or told by colour, plate or screen."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Bool, UInt8
from torch import Tensor

from torchhand.geometry import Camera
from torchhand.image import BackgroundPlate, SilhouetteSettings, SkinModel, bootstrap_skin, segment
from torchhand.numerics import single_threaded

_DARKER = 0.2  # of the pictures have darker skin than is believed: one may be mistaken

Images = Sequence[UInt8[Tensor, "_height _width 3"] | None]
"""One per view; None where it is missing."""
Masks = Sequence[Bool[Tensor, "_height _width"] | None]
"""One per view, of its camera's size; None where nothing is known of the view."""


@dataclass(frozen=True, kw_only=True)
class PackedMask:
    """A mask in an eighth of its memory."""

    bits: UInt8[Tensor, "bytes"]
    shape: tuple[int, int]
    """Height and width."""

    @classmethod
    def of(cls, mask: Bool[Tensor, "height width"]) -> "PackedMask":
        return cls(bits=torch.from_numpy(np.packbits(mask.cpu().numpy())), shape=(mask.shape[0], mask.shape[1]))

    def mask(self) -> Bool[Tensor, "height width"]:
        """As it was, on the CPU."""
        flat = np.unpackbits(self.bits.cpu().numpy(), count=self.shape[0] * self.shape[1])
        return torch.from_numpy(flat.view(bool).reshape(self.shape))


@dataclass(frozen=True, kw_only=True)
class LearnedSkin:
    """The skin of one view, and how far it stood out of the picture that taught it."""

    model: SkinModel
    separability: float
    dark_values: tuple[int, ...] = ()
    """Darkest brightness of skin in each picture that showed skin."""


class ViewSilhouettes:
    """Makes the silhouettes of a fixed rig.

    `cameras` are the rig's without distortion: the silhouettes are as these see them.
    """

    def __init__(
        self,
        cameras: Sequence[Camera],
        settings: SilhouetteSettings | None = None,
        *,
        plates: Sequence[BackgroundPlate] | None = None,
    ) -> None:
        """plates: the empty scene in every view, for the method "background".

        Raises ValueError where that method lacks them or their number is another.
        """
        self.settings = settings or SilhouetteSettings()
        if self.settings.method == "background" and (plates is None or len(plates) != len(cameras)):
            raise ValueError("silhouette.method: 'background' needs a plate of the empty scene for every camera")
        self._plates = plates
        self.cameras = tuple(_without_distortion(camera) for camera in cameras)
        self._maps = [_undistorting(camera) if camera.has_distortion else None for camera in cameras]

    @single_threaded()
    def learn(self, images: Images, known: Sequence[LearnedSkin | None]) -> list[LearnedSkin | None]:
        """The skin of every view after these pictures: that of the clearest picture counts, but skin is believed as
        dark as in the darker ones, where parts of the hand were in the shade."""
        learned = list(known)
        for view, image in enumerate(images):
            if image is None or self.settings.method != "skin":
                continue
            start, old = bootstrap_skin(image), learned[view]
            if not start.has_skin:
                continue
            dark = (start.model.dark_value, *(() if old is None else old.dark_values))
            if old is None or start.separability > old.separability:
                old = LearnedSkin(model=start.model, separability=start.separability)
            dark_value = sorted(dark)[int(_DARKER * len(dark))]
            learned[view] = replace(old, model=replace(old.model, dark_value=dark_value), dark_values=dark)
        return learned

    @single_threaded()
    def __call__(self, images: Images, skins: Sequence[LearnedSkin | None]) -> list[Tensor | None]:
        """Silhouettes of hand and bare forearm; None of views that are missing or whose skin is not known."""
        views = range(len(images))
        return self.undistorted([self._segmented(view, images[view], skins[view]) for view in views])

    def _segmented(self, view: int, image: Tensor | None, skin: LearnedSkin | None) -> Tensor | None:
        if image is None or (self.settings.method == "skin" and skin is None):
            return None
        plate = None if self._plates is None else self._plates[view]
        return segment(image, self.settings, skin=None if skin is None else skin.model, plate=plate)

    def undistorted(self, masks: Masks) -> list[Tensor | None]:
        """Masks as `cameras` would see them. What lies outside the picture is taken for what is at its edge."""
        return [
            mask if mask is None or maps is None else _remapped(mask, maps)
            for mask, maps in zip(masks, self._maps, strict=True)
        ]


def _without_distortion(camera: Camera) -> Camera:
    return replace(camera, distortion=camera.distortion[..., :0])


def _undistorting(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    intrinsics, size = camera.intrinsics.double().cpu().numpy(), (camera.width, camera.height)
    lens = camera.distortion.double().cpu().numpy()
    maps = cv2.initUndistortRectifyMap(intrinsics, lens, np.eye(3), intrinsics, size, cv2.CV_16SC2)
    return np.asarray(maps[0]), np.asarray(maps[1])


def _remapped(mask: Tensor, maps: tuple[np.ndarray, np.ndarray]) -> Tensor:
    pixels = mask.cpu().numpy().view(np.uint8) * 255
    moved = cv2.remap(pixels, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return (torch.from_numpy(moved) > 127).to(mask.device)
