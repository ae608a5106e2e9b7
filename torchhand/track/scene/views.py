"""What the cameras give at one time, and what a tracker makes of it before any hand is compared with it."""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from torchhand.errors import require, require_kind
from torchhand.fit import Observation, grey, mask_plane
from torchhand.hand import HandPose
from torchhand.precision import require_exact

T = TypeVar("T")

Box = tuple[slice, slice]
"""Rows and columns of a picture, with a start and a stop within it."""

_BLUR_PX = 5  # a plane made of a mask is smoothed over so many pixels at most


@dataclass(frozen=True, kw_only=True)
class HandKeypoints:
    """Keypoints that a detector found in one picture."""

    points_px: Float[Tensor, "21 2"]
    """Points in the picture as it was taken; NaN for missing ones."""
    points: Float[Tensor, "21 3"] | None = None
    """Points in space, metres, in any coordinates; NaN for missing ones. None where the detector gives none."""
    score: float = 1.0
    """How sure the detector is, 0 to 1."""

    def __post_init__(self) -> None:
        """Raises TypeError for what is no tensor, ValueError for other shapes and for half precision: pixels beyond 256
        are not whole numbers in it."""
        _require_points("points_px", self.points_px, (21, 2))
        if self.points is not None:
            _require_points("points", self.points, (21, 3))


@dataclass(frozen=True, kw_only=True)
class View:
    """What one camera gives at one time; nothing where its picture is missing."""

    image: UInt8[Tensor, "height width 3"] | None = None
    """The picture, RGB."""
    mask: Bool[Tensor, "height width"] | None = None
    """The hand's silhouette where it is given, in place of one by colour."""
    keypoints: HandKeypoints | None = None
    """Keypoints of the hand where a detector found it."""
    is_detector_silent: bool = False
    """Whether a detector looked for hands in the picture and found none, of either side."""

    def __post_init__(self) -> None:
        """Raises TypeError for what is no tensor and no HandKeypoints, ValueError for an image that is not RGB and a
        mask that is not bool."""
        if self.image is not None:
            _require_picture("image", self.image, "RGB, uint8 (height, width, 3)", torch.uint8, (3,))
        if self.mask is not None:
            _require_picture("mask", self.mask, "bool (height, width)", torch.bool, ())
        if self.keypoints is not None:
            require_kind("keypoints", self.keypoints, HandKeypoints)

    @property
    def is_empty(self) -> bool:
        return self.image is None and self.mask is None and self.keypoints is None

    def is_on(self, device: torch.device) -> bool:
        """Whether all that there is lies on a device."""
        keypoints = () if self.keypoints is None else (self.keypoints.points_px, self.keypoints.points)
        return all(one is None or one.device == device for one in (self.image, self.mask, *keypoints))


def _require_points(name: str, value: Tensor, shape: tuple[int, int]) -> None:
    require_kind(name, value, Tensor)
    require(value.shape == shape, name, f"shape {shape}", tuple(value.shape))
    require_exact(name, value.dtype)


def _require_picture(name: str, value: object, expected: str, dtype: torch.dtype, channels: tuple[int, ...]) -> None:
    if not isinstance(value, Tensor):
        raise TypeError(f"{name}: expected a tensor, {expected}, got {type(value).__name__}")
    if value.dtype != dtype or value.ndim < 2 or value.shape[2:] != channels:
        raise ValueError(f"{name}: expected {expected}, got {value.dtype} {tuple(value.shape)}")


@dataclass(frozen=True, kw_only=True)
class Scene:
    """The views of one time with their silhouettes, one per camera; undistorted where several cameras are used.

    What several estimates need of it is computed once and kept (`once`).
    """

    views: tuple[View, ...]
    masks: tuple[Bool[Tensor, "_height _width"] | None, ...]
    """Silhouettes of hand and bare forearm; None where nothing is known of a view."""
    probabilities: tuple[Float[Tensor, "_height _width"] | None, ...]
    """Probability that a pixel shows the hand, where colours tell it; None elsewhere."""
    time_s: float
    expected: Float[Tensor, "3"] | None = None
    """Where the hand was expected at the time before: the place about which a hull is carved where that is near
    enough, for it is known early. World frame, metres; None where no hand was followed."""
    guesses: tuple[HandPose, ...] = ()
    """Hands that were found at this very time before tracking began: further starts of an update."""
    observations: tuple[Observation, ...] = ()
    """What else is known of the hand at this time, beside what the update rule sees in the views by itself."""
    kept: dict[Hashable, Any] = field(default_factory=dict, repr=False, compare=False)

    @property
    def is_empty(self) -> bool:
        """Whether no view shows anything."""
        return all(view.is_empty for view in self.views)

    def is_known(self, view: int) -> bool:
        """Whether anything is known of a view's silhouette."""
        return self.probabilities[view] is not None or self.masks[view] is not None

    def plane(self, view: int) -> Float[Tensor, "height width"] | None:
        """A picture of one view in which the hand is bright, 0..1; None where nothing is known of it."""
        probability, mask = self.probabilities[view], self.masks[view]
        if probability is not None or mask is None:
            return probability
        return self.once(("plane", view), lambda: mask_plane(mask))

    def grey(self, view: int) -> Float[Tensor, "height width"] | None:
        """Grey levels of one view's picture, 0..1; None where there is no picture."""
        image = self.views[view].image
        return None if image is None else self.once(("grey", view), lambda: grey(image))

    def plane_in(self, view: int, box: Box) -> Float[Tensor, "rows columns"] | None:
        """Part of `plane`; the rest of the picture is not worked out for it."""
        probability, mask = self.probabilities[view], self.masks[view]
        whole = self.kept.get(("plane", view), probability)
        if whole is not None or mask is None:
            return None if whole is None else whole[box]
        (top, bottom), (left, right) = ((part.start, part.stop) for part in box)
        above, before = min(top, _BLUR_PX), min(left, _BLUR_PX)
        around = mask[top - above : bottom + _BLUR_PX, left - before : right + _BLUR_PX]
        return mask_plane(around)[above : above + bottom - top, before : before + right - left]

    def grey_in(self, view: int, box: Box) -> Float[Tensor, "rows columns"] | None:
        """Part of `grey`; the rest of the picture is not worked out for it."""
        image, whole = self.views[view].image, self.kept.get(("grey", view))
        if whole is not None or image is None:
            return None if whole is None else whole[box]
        return grey(image[box])

    def without(self, view: int) -> "Scene":
        """The scene without one view."""
        gone = View()
        return Scene(
            views=tuple(gone if index == view else own for index, own in enumerate(self.views)),
            masks=tuple(None if index == view else own for index, own in enumerate(self.masks)),
            probabilities=tuple(None if index == view else own for index, own in enumerate(self.probabilities)),
            time_s=self.time_s,
            expected=self.expected,
            guesses=self.guesses,
            observations=self.observations,
        )

    def once(self, key: Hashable, make: Callable[[], T]) -> T:
        """What `make` returns, computed the first time."""
        if key not in self.kept:
            self.kept[key] = make()
        return self.kept[key]


ObservationsOf = Callable[[Scene], Sequence[Observation]]
"""Further observations of a scene, poses in the tracker's world; none where nothing was observed."""
