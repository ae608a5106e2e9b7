"""Which part of an arm's silhouettes may be its hand: the end that is farthest from where it leaves the pictures."""

from collections.abc import Sequence

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.fit.hull import SilhouetteRays
from torchhand.geometry import Camera
from torchhand.track.scene import Masks

_SIDE_PX = 240  # longer side of the reduced silhouettes
_REACH = 1.25  # hand lengths from the farthest place that may be the hand
_KERNELS = tuple(cv2.getStructuringElement(kind, (3, 3)) for kind in (cv2.MORPH_CROSS, cv2.MORPH_RECT))


class HandEnd:
    """Tells the places of one frame that may be on the hand from those that are on the arm."""

    def __init__(self, cameras: Sequence[Camera], masks: Masks, hand_length: float) -> None:
        """cameras: without distortion. hand_length: metres."""
        self._lengths: list[tuple[Camera, Tensor]] = []
        for camera, mask in zip(cameras, masks, strict=True):
            lengths = None if mask is None else _lengths_to_end(mask.cpu().numpy().view(np.uint8))
            if lengths is not None:
                self._lengths.append((camera, torch.from_numpy(lengths).to(camera.rotation.device)))
        self._reach = _REACH * hand_length

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


def _lengths_to_end(mask: np.ndarray) -> np.ndarray | None:
    """Length in reduced pixels from each pixel of a silhouette to the one farthest from the picture's border, measured
    through the silhouette from the border on; outside, that of the nearest pixel inside. None where the silhouette does
    not touch the border."""
    height, width = mask.shape
    scale = min(1.0, _SIDE_PX / max(height, width))
    size = (max(1, round(scale * width)), max(1, round(scale * height)))
    filled = (cv2.resize(mask * 255, size, interpolation=cv2.INTER_AREA) > 127).astype(np.uint8)
    reached = filled.copy()
    reached[1:-1, 1:-1] = 0
    if not reached.any():
        return None
    lengths, step = np.zeros(filled.shape, np.float32), 0
    while True:
        step += 1
        grown = cv2.bitwise_and(cv2.dilate(reached, _KERNELS[step % 2]), filled)
        is_new = grown > reached
        if not is_new.any():
            break
        lengths[is_new] = step
        reached = grown
    lengths = np.where(reached > 0, lengths.max() - lengths, 0.0).astype(np.float32)
    _, labels = cv2.distanceTransformWithLabels(1 - filled, cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL)
    label = np.asarray(labels, np.int64)
    of_label = np.zeros(int(label.max()) + 1, np.float32)
    of_label[label[filled > 0]] = lengths[filled > 0]
    return of_label[label]
