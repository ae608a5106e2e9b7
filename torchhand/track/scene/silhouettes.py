"""The hand's silhouette in every view, without the lens's distortion: given, or told by colour, plate or screen."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from torchhand.fit.detect import are_colours_shared, cut_at_keypoints
from torchhand.geometry import Camera
from torchhand.hand import KEYPOINTS
from torchhand.image import (
    BackgroundPlate,
    Light,
    SilhouetteSettings,
    SkinModel,
    bootstrap_skin,
    hand_region,
    segment,
    skin_probability,
)
from torchhand.numerics import single_threaded

_MOST_JUDGED = 5
"""Pictures of a view in which its skin is judged: one with other things of this skin about the hand is enough."""
_MORE = 0.15
"""Of a hand's area: what its silhouette has beside it where its skin is shared. By this, and by things elsewhere, it is
in ten of ten pictures before clutter, and in none of 144 of a real rig (`stereo_desk`) and of simulated ones."""
_MIDDLE, _REACH = KEYPOINTS.index("middle_mcp"), 2.4  # reach of the hand's end from the wrist, lengths of the palm
_DARKER = 0.2  # of the pictures have darker skin than is believed: one may be mistaken

Images = Sequence[UInt8[Tensor, "_height _width 3"] | None]
"""One per view; None where it is missing."""
Masks = Sequence[Bool[Tensor, "_height _width"] | None]
"""One per view, of its camera's size; None where nothing is known of the view."""

Points = Sequence[Float[Tensor, "21 2"] | None]
"""Detected keypoints, one hand's per view, px; None where there are none."""


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
    light: Light
    """The light in which it is this skin."""
    dark_values: tuple[int, ...] = ()
    """Darkest brightness of skin in each picture that showed skin."""
    judged: int = 0
    """Pictures in which a detector told where the hand is."""
    is_shared: bool = False
    """Whether in one of them this skin did not tell it from its surroundings: it is cut out about detected points
    rather, where there are any."""


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
    def learn(
        self, images: Images, known: Sequence[LearnedSkin | None], points: Points | None = None
    ) -> list[LearnedSkin | None]:
        """The skin of every view after these pictures: that of the clearest picture counts, but skin is believed as
        dark as in the darker ones, where parts of the hand were in the shade. points: detected in these, as `cameras`
        see them: whether the skin is that of other things too is judged in the first that have them."""
        learned = list(known)
        for view, image in enumerate(images):
            if image is None or self.settings.method != "skin":
                continue
            old = learned[view]
            start = bootstrap_skin(image if old is None else old.light.undone(image))
            if not start.has_skin:
                continue
            dark = (start.model.dark_value, *(() if old is None else old.dark_values))
            if old is None:
                old = LearnedSkin(model=start.model, separability=start.separability, light=Light.of(image))
            elif start.separability > old.separability:
                old = replace(old, model=start.model, separability=start.separability)
            dark_value = sorted(dark)[int(_DARKER * len(dark))]
            old = replace(old, model=replace(old.model, dark_value=dark_value), dark_values=dark)
            learned[view] = old if points is None else self._judged(view, image, old, points[view])
        return learned

    def _judged(self, view: int, image: Tensor, skin: LearnedSkin, points: Tensor | None) -> LearnedSkin:
        if points is None or skin.is_shared or skin.judged >= _MOST_JUDGED:
            return skin
        cut, maps = self._cut(view, image, points), self._maps[view]
        mask = _undistorted(self._segmented(view, image, skin), maps)
        alike = _undistorted(skin_probability(skin.light.undone(image), skin.model) > 0.5, maps)
        if cut is None or mask is None or alike is None:
            return skin
        is_shared = _more_than(mask, cut, points) > _MORE and are_colours_shared(alike.double(), cut, points)
        return replace(skin, judged=skin.judged + 1, is_shared=is_shared)

    def _cut(self, view: int, image: Tensor, points: Tensor) -> Tensor | None:
        maps = self._maps[view]
        if maps is not None:
            moved = cv2.remap(image.cpu().numpy(), *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            image = torch.from_numpy(moved).to(image.device)
        return cut_at_keypoints(image, points)

    @single_threaded()
    def __call__(
        self, images: Images, skins: Sequence[LearnedSkin | None], points: Points | None = None
    ) -> list[Tensor | None]:
        """Silhouettes of hand and bare forearm; None of views that are missing or whose skin is not known. points: as
        `cameras` see them; about these the hand is cut out where its skin is shared."""
        found: list[Tensor | None] = []
        for view, (image, skin) in enumerate(zip(images, skins, strict=True)):
            own, cut = None if points is None else points[view], None
            if image is not None and own is not None and skin is not None and skin.is_shared:
                cut = self._cut(view, image, own)
            seen = _undistorted(self._segmented(view, image, skin), self._maps[view]) if cut is None else cut
            found.append(seen)
        return found

    def _segmented(self, view: int, image: Tensor | None, skin: LearnedSkin | None) -> Tensor | None:
        if image is None or (self.settings.method == "skin" and skin is None):
            return None
        plate = None if self._plates is None else self._plates[view]
        if skin is None:
            return segment(image, self.settings, plate=plate)
        return segment(skin.light.undone(image), self.settings, skin=skin.model, plate=plate)

    def undistorted(self, masks: Masks) -> list[Tensor | None]:
        """Masks as `cameras` would see them. What lies outside the picture is taken for what is at its edge."""
        return [_undistorted(mask, maps) for mask, maps in zip(masks, self._maps, strict=True)]


def _more_than(mask: Tensor, cut: Tensor, points: Tensor) -> float:
    """What a silhouette has about a hand beside what is cut out, in shares of that; forearms do not count."""
    palm = points[_MIDDLE] - points[0]
    near = hand_region((mask.shape[0], mask.shape[1]), points[0], points[_MIDDLE], _REACH * float(palm.norm()))
    return float((mask & ~cut & near).sum()) / max(float((cut & near).sum()), 1.0)


def _without_distortion(camera: Camera) -> Camera:
    return replace(camera, distortion=camera.distortion[..., :0])


def _undistorting(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    intrinsics, size = camera.intrinsics.double().cpu().numpy(), (camera.width, camera.height)
    lens = camera.distortion.double().cpu().numpy()
    maps = cv2.initUndistortRectifyMap(intrinsics, lens, np.eye(3), intrinsics, size, cv2.CV_16SC2)
    return np.asarray(maps[0]), np.asarray(maps[1])


def _undistorted(mask: Tensor | None, maps: tuple[np.ndarray, np.ndarray] | None) -> Tensor | None:
    if mask is None or maps is None:
        return mask
    pixels = mask.cpu().numpy().view(np.uint8) * 255
    moved = cv2.remap(pixels, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return (torch.from_numpy(moved) > 127).to(mask.device)
