"""How a posed hand and the silhouettes of all views agree."""

import math
from collections.abc import Sequence

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.geometry import Camera
from torchhand.hand import HandKinematics
from torchhand.track.appearance import hand_region, overlap, touching
from torchhand.track.multiview.silhouettes import Masks
from torchhand.view import HandProjector

_REACH = 1.3  # silhouettes are compared so far from the wrist, hand lengths
_STEEP = 0.25  # a palm seen shorter than this, hand lengths, has no direction in the picture
_RING = 0.12  # there silhouettes are compared so far around the model, hand lengths


class ViewAgreement:
    """Overlaps of one hand's silhouettes with the pictures', in reduced pictures."""

    def __init__(
        self,
        kinematics: HandKinematics,
        cameras: Sequence[Camera],
        shape: Float[Tensor, "shape"],
        *,
        side_px: int = 320,
    ) -> None:
        """cameras: without distortion. side_px: longer side of the reduced pictures."""
        self.shape = shape
        reduced = [camera.resized(min(1.0, side_px / max(camera.width, camera.height))) for camera in cameras]
        self._projectors = [HandProjector(kinematics, camera, shape) for camera in reduced]
        self._length = float(kinematics.shape_space.metric(shape)["hand_length"])

    def __call__(
        self, pose: Float[Tensor, "36"], root_reference: Float[Tensor, "3 3"], masks: Masks
    ) -> Float[Tensor, "views"]:
        """Intersection over union in every view, NaN in views without a mask; the forearm, cut off at the wrist where
        the view shows it, does not count, nor does what is apart from the hand."""
        frames = self._projectors[0].frames(pose, root_reference)
        found = [self._overlap(p, frames, mask) for p, mask in zip(self._projectors, masks, strict=True)]
        return torch.tensor(found, dtype=torch.float64)

    def _overlap(self, projector: HandProjector, frames, mask: Tensor | None) -> float:
        if mask is None:
            return math.nan
        camera = projector.camera
        model = projector.silhouette_of(projector.primitives_cam(frames))
        pixels = cv2.resize(
            mask.cpu().numpy().view(np.uint8) * 255, (camera.width, camera.height), interpolation=cv2.INTER_AREA
        )
        picture = touching(torch.from_numpy(pixels > 127), model)
        return overlap(model, picture, self._region(camera, frames.keypoints, model))

    def _region(self, camera: Camera, keypoints: Tensor, model: Tensor) -> Bool[Tensor, "height width"]:
        wrist, knuckle = camera.project(keypoints[0]), camera.project(keypoints[9])
        depth = float(camera.cam_from_world(keypoints[0])[2])
        focal = float(camera.intrinsics[0, 0])
        length_px = self._length * focal / (max(depth, 1e-3) if camera.kind == "pinhole" else 1.0)
        if float((knuckle - wrist).norm()) > _STEEP * length_px:
            return hand_region((camera.height, camera.width), wrist, knuckle, _REACH * length_px)
        size = 2 * max(1, round(min(_RING * length_px, camera.width))) + 1
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
        return torch.from_numpy(cv2.dilate(model.numpy().view(np.uint8), kernel) > 0)


def mean_overlap(overlaps: Float[Tensor, "views"]) -> float:
    """Over the views that there are; 0 where there is none."""
    known = overlaps[overlaps.isfinite()]
    return float(known.mean()) if len(known) else 0.0
