"""Which part of an arm's silhouettes may be its hand: the end that is farthest from where it leaves the pictures."""

from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.fit.hull import SilhouetteRays
from torchhand.geometry import Camera
from torchhand.track.scene import END_REACH, Masks, lengths_to_end


class HandEnd:
    """Tells the places of one frame that may be on the hand from those that are on the arm."""

    def __init__(self, cameras: Sequence[Camera], masks: Masks, hand_length: float) -> None:
        """cameras: without distortion. hand_length: metres."""
        self._lengths: list[tuple[Camera, Tensor]] = []
        for camera, mask in zip(cameras, masks, strict=True):
            lengths = None if mask is None else lengths_to_end(mask)
            if lengths is not None:
                self._lengths.append((camera, lengths.to(camera.rotation.device)))
        self._reach = END_REACH * hand_length

    def __call__(self, points: Float[Tensor, "n 3"]) -> Bool[Tensor, "n"]:
        """Whether places of the hull may be on the hand, by all views whose silhouette goes on beyond the picture."""
        may_be = torch.ones(len(points), dtype=torch.bool, device=points.device)
        for camera, lengths in self._lengths:
            may_be &= self._in_view(camera, lengths, points)
        return may_be

    def rays(self, rays: SilhouetteRays, count: int) -> SilhouetteRays:
        """About `count` of those rays that may touch the hand, which are of silhouettes of these cameras; of all where
        none may."""
        first, kept = 0, []
        for view in rays.views:
            points = rays.points[first : first + len(view.plane)]
            first += len(points)
            own = [self._in_view(camera, lengths, points) for camera, lengths in self._lengths if camera is view.camera]
            kept.append((own[0] if own else torch.ones_like(points[:, 0], dtype=torch.bool)).nonzero()[:, 0])
        return (rays.chosen(kept) if any(map(len, kept)) else rays).thinned(count)

    def _in_view(self, camera: Camera, lengths: Tensor, points: Float[Tensor, "n 3"]) -> Bool[Tensor, "n"]:
        points = points.to(camera.rotation)
        reduced = camera.resized(lengths.shape[1] / camera.width)
        x, y = reduced.project(points).nan_to_num().round().long().unbind(-1)
        depth = reduced.cam_from_world(points)[:, 2] if camera.kind == "pinhole" else 1.0
        length = lengths[y.clamp(0, lengths.shape[0] - 1), x.clamp(0, lengths.shape[1] - 1)]
        return length * depth <= self._reach * reduced.intrinsics[0, 0]
