"""How a posed hand and the silhouettes of all views agree."""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.geometry import Camera
from torchhand.hand import HandFrames, HandKinematics, Primitives, place_primitives
from torchhand.image import dilate, disc_kernel, hand_region, intersection_over_union, reduced_mask, touching
from torchhand.track.multiview.silhouettes import Masks
from torchhand.view import HandProjector
from torchhand.view.generators import generators
from torchhand.view.projector import Generators

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
        kinds = [[v for v, p in enumerate(self._projectors) if p.is_orthographic == kind] for kind in (False, True)]
        self._alike = [views for views in kinds if views]
        self._rotation = torch.stack([camera.rotation for camera in reduced])
        self._translation = torch.stack([camera.translation for camera in reduced])

    def __call__(
        self, pose: Float[Tensor, "36"], root_reference: Float[Tensor, "3 3"], masks: Masks
    ) -> Float[Tensor, "views"]:
        """Intersection over union in every view, NaN in views without a mask; the forearm, cut off at the wrist where
        the view shows it, does not count, nor does what is apart from the hand."""
        frames = self._projectors[0].frames(pose, root_reference)
        parts = zip(self._projectors, self._seen_by_all(frames), masks, strict=True)
        found = [self._overlap(projector, seen, frames.keypoints, mask) for projector, seen, mask in parts]
        return torch.tensor(found, dtype=torch.float64)

    def _seen_by_all(self, frames: HandFrames) -> list[tuple[Primitives, Generators]]:
        """The primitives as each camera sees them, with their generators; those of like cameras are found together."""
        first = self._projectors[0]
        placed = place_primitives(frames, first.sizes, is_left=first.kinematics.side == "left")
        rotation = self._rotation[:, None] @ placed.rotation
        position = placed.position @ self._rotation.mT + self._translation[:, None]
        found: list[tuple[Primitives, Generators]] = [()] * len(rotation)  # pyright: ignore[reportAssignmentType]
        for views in self._alike:
            seen = Primitives(sizes=placed.sizes, rotation=rotation[views], position=position[views])
            is_orthographic = self._projectors[views[0]].is_orthographic
            cones, arcs = generators(seen, is_orthographic=is_orthographic, with_normals=False)
            for place, view in enumerate(views):
                found[view] = (seen.select(place), (cones.of_hand(place), arcs.of_hand(place)))
        return found

    def _overlap(
        self, projector: HandProjector, seen: tuple[Primitives, Generators], keypoints: Tensor, mask: Tensor | None
    ) -> float:
        if mask is None:
            return math.nan
        camera = projector.camera
        model = projector.silhouette_of(*seen)
        picture = touching(reduced_mask(mask.to(model.device), camera.height, camera.width), model)
        return float(intersection_over_union(model, picture, self._region(camera, keypoints, model), empty=0.0))

    def _region(self, camera: Camera, keypoints: Tensor, model: Tensor) -> Bool[Tensor, "height width"]:
        in_cam = camera.cam_from_world(keypoints[[0, 9]])
        wrist, knuckle = camera.pixels_from_plane(camera.plane_from_cam(in_cam))
        depth = float(in_cam[0, 2])
        focal = float(camera.intrinsics[0, 0])
        length_px = self._length * focal / (max(depth, 1e-3) if camera.kind == "pinhole" else 1.0)
        if float((knuckle - wrist).norm()) > _STEEP * length_px:
            return hand_region((camera.height, camera.width), wrist, knuckle, _REACH * length_px)
        return dilate(model, disc_kernel(max(1, round(min(_RING * length_px, camera.width)))))


def score_of(overlap: float, covered_share: float) -> float:
    """How much of the pictures a hand explains, 0 to 1: the silhouettes' areas and their edges, in equal shares."""
    return 0.5 * (overlap + covered_share)


def mean_overlap(overlaps: Float[Tensor, "views"]) -> float:
    """Over the views that there are; 0 where there is none."""
    known = overlaps[overlaps.isfinite()]
    return float(known.mean()) if len(known) else 0.0
