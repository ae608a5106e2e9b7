"""How a posed hand and the silhouettes of all views agree."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.fit import hand_region, overlap, touching, unexplained_px
from torchhand.geometry import Camera
from torchhand.hand import HandFrames, HandKinematics, HandPose, Primitives, place_primitives
from torchhand.track.scene.views import Scene
from torchhand.view import HandProjector
from torchhand.view.outlines import Generators, generators

_REACH = 1.3  # silhouettes are compared so far from the wrist, hand lengths
_STEEP = 0.25  # a palm seen shorter than this, hand lengths, has no direction in the picture
_RING = 0.12  # there silhouettes are compared so far around the model, hand lengths
_FINGER = 0.03  # radius of a disc that fits into every finger, hand lengths


@dataclass(frozen=True, kw_only=True)
class Agreement:
    """How a model's silhouettes and the pictures' compare."""

    overlaps: Float[Tensor, "views"]
    """Intersection over union, forearm cut at the wrist; NaN in views without a silhouette."""
    unexplained: Float[Tensor, "views"]
    """Area of the picture's hand outside the model, in pieces as thick as a finger, in squares of the hand's length."""

    @property
    def overlap(self) -> float:
        """Mean over the views that there are; 0 where there is none."""
        known = self.overlaps[self.overlaps.isfinite()]
        return float(known.mean()) if len(known) else 0.0

    @property
    def most_unexplained(self) -> float:
        """Of the view that explains least; 0 where there is none."""
        known = self.unexplained[self.unexplained.isfinite()]
        return float(known.max()) if len(known) else 0.0

    @property
    def views(self) -> int:
        """Views that were compared."""
        return int(self.overlaps.isfinite().sum())


class SilhouetteComparison:
    """Compares silhouettes of one hand with the pictures', in reduced pictures."""

    def __init__(
        self,
        kinematics: HandKinematics,
        cameras: Sequence[Camera],
        shape: Float[Tensor, "shape"],
        *,
        side_px: int,
    ) -> None:
        """cameras: as they see the scene's silhouettes. side_px: longer side of the reduced pictures."""
        self.shape = shape
        reduced = [camera.resized(min(1.0, side_px / max(camera.width, camera.height))) for camera in cameras]
        self._projectors = [HandProjector(kinematics, camera, shape) for camera in reduced]
        self._length = float(kinematics.shape_space.metric(shape)["hand_length"])
        kinds = [[v for v, p in enumerate(self._projectors) if p.is_orthographic == kind] for kind in (False, True)]
        self._alike = [views for views in kinds if views]
        self._rotation = torch.stack([camera.rotation for camera in reduced])
        self._translation = torch.stack([camera.translation for camera in reduced])

    def __call__(self, pose: HandPose, scene: Scene) -> Agreement:
        """In every view; what is apart from the hand does not count."""
        frames = self._projectors[0].frames(pose.dofs, pose.reference)
        parts = zip(self._projectors, self._seen_by_all(frames), range(len(scene.views)), strict=True)
        found = [self._compared(projector, seen, frames.keypoints, scene, view) for projector, seen, view in parts]
        overlaps, unexplained = torch.tensor(found, dtype=torch.float64).T
        return Agreement(overlaps=overlaps, unexplained=unexplained)

    def _seen_by_all(self, frames: HandFrames) -> list[tuple[Primitives, Generators]]:
        """The primitives as each camera sees them, with their generators; those of like cameras are found together."""
        first = self._projectors[0]
        placed = place_primitives(frames, first.sizes, is_left=first.kinematics.side == "left")
        rotation = self._rotation[:, None] @ placed.rotation
        position = placed.position @ self._rotation.mT + self._translation[:, None]
        found: dict[int, tuple[Primitives, Generators]] = {}
        for views in self._alike:
            seen = Primitives(sizes=placed.sizes, rotation=rotation[views], position=position[views])
            is_orthographic = self._projectors[views[0]].is_orthographic
            cones, arcs = generators(seen, is_orthographic=is_orthographic, with_normals=False)
            for place, view in enumerate(views):
                found[view] = (seen.select(place), (cones.of_hand(place), arcs.of_hand(place)))
        return [found[view] for view in range(len(self._projectors))]

    def _compared(
        self,
        projector: HandProjector,
        seen: tuple[Primitives, Generators],
        keypoints: Tensor,
        scene: Scene,
        view: int,
    ) -> tuple[float, float]:
        """Overlap, and area unexplained."""
        camera = projector.camera
        size = (camera.width, camera.height)
        reduced = scene.once(("reduced", view, size), lambda: _reduced(scene, view, size))
        if reduced is None:
            return math.nan, math.nan
        model = projector.silhouette_of(*seen)
        picture = touching(reduced, model)
        in_cam = camera.cam_from_world(keypoints[[0, 9]])
        depth = float(in_cam[0, 2])
        focal = 0.5 * float(camera.intrinsics[0, 0] + camera.intrinsics[1, 1])
        length_px = self._length * focal / (max(depth, 1e-3) if camera.kind == "pinhole" else 1.0)
        region = self._region(camera, in_cam, model, length_px)
        missed = unexplained_px(model, picture, region, _FINGER * length_px) / length_px**2
        return overlap(model, picture, region), missed

    def _region(self, camera: Camera, in_cam: Tensor, model: Tensor, length_px: float) -> Bool[Tensor, "height width"]:
        """Where hand and picture can be compared: on the fingers' side of the wrist, or around the model."""
        wrist, knuckle = camera.pixels_from_plane(camera.plane_from_cam(in_cam))
        if float((knuckle - wrist).norm()) > _STEEP * length_px:
            return hand_region((camera.height, camera.width), wrist, knuckle, _REACH * length_px)
        size = 2 * max(1, round(min(_RING * length_px, camera.width))) + 1
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
        return torch.from_numpy(cv2.dilate(model.numpy().view(np.uint8), kernel) > 0)


def _reduced(scene: Scene, view: int, size: tuple[int, int]) -> Bool[Tensor, "height width"] | None:
    """The silhouette of a view in a reduced picture: what is probably hand in the mean over a pixel's area."""
    plane, mask = scene.probabilities[view], scene.masks[view]
    if plane is not None:
        small = cv2.resize(plane.numpy(), size, interpolation=cv2.INTER_AREA)
        return torch.from_numpy(small > 0.5)
    if mask is None:
        return None
    small = cv2.resize(mask.cpu().numpy().view(np.uint8) * 255, size, interpolation=cv2.INTER_AREA)
    return torch.from_numpy(small > 127)
