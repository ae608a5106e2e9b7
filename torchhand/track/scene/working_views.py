"""Views as they are worked on: of a bounded size, keypoints as the cameras that are used would see them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.devices import sent_to
from torchhand.geometry import Camera
from torchhand.image import BackgroundPlate, PicturePart
from torchhand.track.scene.views import View


class WorkingViews:
    """Brings views of cameras to `cameras`: the same, with pictures of at most so many pixels."""

    def __init__(self, given: Sequence[Camera], max_pixels: int, *, scale: float = 1.0) -> None:
        """scale: pixels to one of the given cameras, along a side, where these are not too many."""
        self.given = tuple(given)
        sizes = [(camera.width, camera.height) for camera in given]
        self._parts = [PicturePart.of((0, 0), size, max_pixels, scale=scale) for size in sizes]
        self.cameras = tuple(
            camera if part.size == part.part else camera.of_part(part.corner, part.part, part.size)
            for camera, part in zip(self.given, self._parts, strict=True)
        )
        self._last: dict[int, tuple[Camera, View, View]] = {}
        """Of every camera the view that came last, and what became of it."""

    def of(self, view: View, index: int, used: Camera) -> View:
        """A view as camera `used` sees it: `cameras[index]`, or the same without distortion, whose pictures are
        undistorted later. The very same one for the same view."""
        given, part = self.given[index], self._parts[index]
        is_whole = part.size == part.part
        is_undistorted = given.has_distortion and not used.has_distortion
        device = used.intrinsics.device
        if is_whole and (view.keypoints is None or not is_undistorted) and view.is_on(device):
            return view
        if index in self._last and self._last[index][0] is used and is_same_view(self._last[index][1], view):
            return self._last[index][2]
        keypoints = None if view.keypoints is None else sent_to(view.keypoints, device)
        if keypoints is not None and is_undistorted:
            points = used.pixels_from_plane(given.plane_from_pixels(keypoints.points_px.to(used.intrinsics)))
            keypoints = replace(keypoints, points_px=points)
        elif keypoints is not None and not is_whole:
            points = torch.from_numpy(part.part_px(keypoints.points_px.cpu().numpy())).to(keypoints.points_px)
            keypoints = replace(keypoints, points_px=points)
        image = view.image if is_whole or view.image is None else part.image(view.image)
        mask = view.mask if is_whole or view.mask is None else part.mask(view.mask)
        own = View(
            image=None if image is None else image.to(device),
            mask=None if mask is None else mask.to(device),
            keypoints=keypoints,
            is_detector_silent=view.is_detector_silent,
        )
        self._last[index] = (used, view, own)
        return own

    def whole_px(self, points_px: Float[Tensor, "*points 2"], index: int) -> Float[Tensor, "*points 2"]:
        """Points of a camera's resampled picture in the picture as it was taken."""
        whole = self._parts[index].whole_px(points_px.cpu().numpy())
        return torch.from_numpy(whole).to(points_px)

    def plates(self, plates: Sequence[BackgroundPlate] | None) -> Sequence[BackgroundPlate] | None:
        """The empty scene in pictures of that size."""
        if plates is None or len(plates) != len(self._parts):
            return plates
        return [
            plate if part.size == part.part else plate.of_part(part)
            for plate, part in zip(plates, self._parts, strict=True)
        ]

    def points(self, points: tuple[float, float, float, float] | None) -> tuple[float, float, float, float] | None:
        """Two points of the first camera's picture, (x, y, x, y)."""
        if points is None:
            return None
        (x0, y0), (x1, y1) = self._parts[0].part_px(np.reshape(points, (2, 2))).tolist()
        return x0, y0, x1, y1


def is_same_view(one: View, other: View) -> bool:
    """Whether two views are the very same picture, mask and keypoints."""
    return all(getattr(one, name) is getattr(other, name) for name in ("image", "mask", "keypoints"))
