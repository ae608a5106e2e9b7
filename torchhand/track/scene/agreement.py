"""How a posed hand and the silhouettes of all views agree."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.fit import unexplained_px
from torchhand.geometry import Camera
from torchhand.hand import HandFrames, HandKinematics, HandPose, Primitives, place_primitives
from torchhand.image import (
    dilate,
    disc_kernel,
    hand_region,
    intersection_over_union,
    reduced,
    reduced_mask,
    touching,
)
from torchhand.track.scene.arm_end import is_on_arm
from torchhand.track.scene.forearm import forearm_mismatch
from torchhand.track.scene.silhouettes import Masks
from torchhand.track.scene.views import Scene
from torchhand.view import HandProjector, OutlineTable, visible_points
from torchhand.view.outlines import Generators, Polygons, generators, outline_of

_REACH = 1.3  # silhouettes are compared so far from the wrist, hand lengths
_STEEP = 0.25  # a palm seen shorter than this, hand lengths, has no direction in the picture
_RING = 0.12  # there silhouettes are compared so far around the model, hand lengths
_SHOWN = 0.25  # share of the keypoints in a picture of several, below which too little of the hand is there to compare
_FINGER = 0.03  # radius of a disc that fits into every finger, hand lengths


@dataclass(frozen=True, kw_only=True)
class Agreement:
    """How a model's silhouettes and the pictures' compare."""

    overlaps: Float[Tensor, "views"]
    """Intersection over union, forearm cut at the wrist; NaN in views without a silhouette, and in those of several
    whose pictures hardly show the hand."""
    unexplained: Float[Tensor, "views"]
    """Area of the picture's hand outside the model, in pieces as thick as a finger, in squares of the hand's length."""
    beyond: Float[Tensor, "views"]
    """How far the picture beyond the wrist differs from every forearm and from nothing, in squares of the hand's length
    (`forearm_mismatch`), and of one view alone, where the hand is cut by the picture and the arm ends elsewhere in it,
    from nothing; NaN as the overlaps are."""

    @classmethod
    def of_overlaps(cls, overlaps: Float[Tensor, "views"]) -> "Agreement":
        """Where nothing else was measured."""
        unknown = torch.full_like(overlaps, math.nan)
        return cls(overlaps=overlaps, unexplained=unknown, beyond=unknown)

    @cached_property
    def overlap(self) -> float:
        """Mean over the views that there are; 0 where there is none."""
        return mean_overlap(self.overlaps)

    @cached_property
    def most_unexplained(self) -> float:
        """Of the view that explains least; 0 where there is none."""
        known = self.unexplained[self.unexplained.isfinite()]
        return float(known.max()) if len(known) else 0.0

    @cached_property
    def mean_beyond(self) -> float:
        """Over the views that there are; 0 where there is none."""
        return mean_overlap(self.beyond)

    @cached_property
    def views(self) -> int:
        """Views that were compared."""
        return int(self.overlaps.isfinite().sum())


@dataclass(frozen=True, kw_only=True)
class AlikeViews:
    """A hand before cameras of one kind, which are asked together."""

    views: tuple[int, ...]
    """Numbers of the cameras."""
    is_orthographic: bool
    primitives: Primitives
    """The primitives in each camera's frame."""
    generators: Generators
    """Contour generators with normals."""

    @classmethod
    def of(cls, primitives: Primitives, views: Sequence[int], *, is_orthographic: bool) -> "AlikeViews":
        """primitives: those in the cameras' frames, a row for each camera."""
        found = generators(primitives, is_orthographic=is_orthographic, with_normals=True)
        return cls(views=tuple(views), is_orthographic=is_orthographic, primitives=primitives, generators=found)

    @cached_property
    def polygons(self) -> Polygons:
        """Polygons whose union is the silhouette."""
        return Polygons.of(self.generators)

    def visible(self, table: OutlineTable) -> Bool[Tensor, "views points"]:
        """Which outline points of the table each camera sees."""
        seen = outline_of(*self.generators, table, (len(self.views),))
        return visible_points(self.primitives, seen, table, is_orthographic=self.is_orthographic)


@dataclass(frozen=True, kw_only=True)
class SeenHand:
    """A hand before one camera."""

    primitives: Primitives
    """The primitives in the camera's frame."""
    generators: Generators
    """Contour generators with normals."""
    polygons: Polygons
    """Polygons whose union is the silhouette."""


@dataclass(frozen=True, kw_only=True)
class PlacedHand:
    """A hand before cameras, whatever the size of their pictures."""

    frames: HandFrames
    """Bones and keypoints in the world."""
    alike: tuple[AlikeViews, ...]
    """The hand before every camera, those of one kind together."""

    @cached_property
    def views(self) -> tuple[SeenHand, ...]:
        """The hand before every camera, in their order."""
        found: dict[int, SeenHand] = {}
        for together in self.alike:
            cones, arcs = together.generators
            for place, view in enumerate(together.views):
                found[view] = SeenHand(
                    primitives=together.primitives.select(place),
                    generators=(cones.of_hand(place), arcs.of_hand(place)),
                    polygons=together.polygons.of_hand(place),
                )
        return tuple(found[view] for view in range(len(found)))

    def visible(self, table: OutlineTable) -> list[Bool[Tensor, "points"]]:
        """Which outline points of the table each camera sees."""
        found = {
            view: row for own in self.alike for view, row in zip(own.views, own.visible(table).unbind(), strict=True)
        }
        return [found[view] for view in range(len(found))]


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
        small = [camera.resized(min(1.0, side_px / max(camera.width, camera.height))) for camera in cameras]
        self._projectors = [HandProjector(kinematics, camera, shape) for camera in small]
        self._length = float(kinematics.shape_space.metric(shape)["hand_length"])
        kinds = [[v for v, p in enumerate(self._projectors) if p.is_orthographic == kind] for kind in (False, True)]
        self._alike = [views for views in kinds if views]
        self._rotation = torch.stack([camera.rotation for camera in small])
        self._translation = torch.stack([camera.translation for camera in small])
        self._focal = torch.stack([camera.intrinsics.diagonal()[:2] for camera in small]).to(self._rotation)[:, None]
        self._centre = torch.stack([camera.intrinsics[:2, 2] for camera in small]).to(self._rotation)[:, None]
        last = [(camera.width - 1.0, camera.height - 1.0) for camera in small]
        self._last = torch.tensor(last, dtype=self._rotation.dtype, device=self._rotation.device)[:, None]
        self._is_pinhole = torch.tensor([not one.is_orthographic for one in self._projectors], device=self._last.device)

    def __call__(self, hand: HandPose | PlacedHand, scene: Scene) -> Agreement:
        """Of a hand () in every view; what is apart from it does not count."""
        placed, found = self.placed(hand) if isinstance(hand, HandPose) else hand, []
        for compared in self._compared(placed, [self._reduced(scene, view) for view in range(len(scene.views))]):
            if compared is None:
                found.append((math.nan,) * 3)
            else:
                found.append((compared.overlap, compared.unexplained, compared.beyond))
        overlaps, unexplained, beyond = torch.tensor(found, dtype=torch.float64).T
        return Agreement(overlaps=overlaps, unexplained=unexplained, beyond=beyond)

    def overlaps(self, hand: HandPose | PlacedHand, masks: Masks) -> Float[Tensor, "views"]:
        """Intersection over union alone, with silhouettes of any size; NaN in views without one."""
        placed = self.placed(hand) if isinstance(hand, HandPose) else hand
        cameras = [projector.camera for projector in self._projectors]
        small = [
            None if mask is None else reduced_mask(mask.to(self.shape.device), camera.height, camera.width)
            for camera, mask in zip(cameras, masks, strict=True)
        ]
        found = [math.nan if compared is None else compared.overlap for compared in self._compared(placed, small)]
        return torch.tensor(found, dtype=torch.float64)

    def _reduced(self, scene: Scene, view: int) -> Bool[Tensor, "height width"] | None:
        """The silhouette of a view in its reduced picture, made once for all comparisons of that size."""
        camera = self._projectors[view].camera
        size = (camera.height, camera.width)
        return scene.once(("reduced", view, size), lambda: _reduced(scene, view, size, self.shape.device))

    def placed(self, pose: HandPose) -> PlacedHand:
        """A hand () before the cameras; those that are alike are asked together."""
        first = self._projectors[0]
        frames = first.frames(pose.dofs, pose.reference)
        placed = place_primitives(frames, first.sizes, is_left=first.kinematics.side == "left")
        rotation = self._rotation[:, None] @ placed.rotation
        position = placed.position @ self._rotation.mT + self._translation[:, None]
        alike = []
        for views in self._alike:
            seen = Primitives(sizes=placed.sizes, rotation=rotation[views], position=position[views])
            is_orthographic = self._projectors[views[0]].is_orthographic
            alike.append(AlikeViews.of(seen, views, is_orthographic=is_orthographic))
        return PlacedHand(frames=frames, alike=tuple(alike))

    def _compared(self, placed: PlacedHand, silhouettes: Masks) -> Iterator["_Compared | None"]:
        keypoints = placed.frames.keypoints
        parts = (self._projectors, placed.views, silhouettes, self._are_shown(keypoints))
        for projector, seen, silhouette, is_shown in zip(*parts, strict=True):
            yield self._in_view(projector, seen, keypoints, silhouette) if silhouette is not None and is_shown else None

    def _are_shown(self, keypoints: Float[Tensor, "21 3"]) -> list[bool]:
        """Which pictures show enough of a hand to be compared with it; a single one always: how much of the hand it
        shows is judged elsewhere."""
        if len(self._projectors) == 1:
            return [True]
        in_cam = keypoints @ self._rotation.mT + self._translation[:, None]
        depth = torch.where(self._is_pinhole[:, None, None], in_cam[..., 2:], 1.0)
        pixels = in_cam[..., :2] / depth * self._focal + self._centre
        is_in = ((pixels >= 0) & (pixels <= self._last) & (depth > 0)).all(-1)
        return (is_in.to(pixels).mean(-1) >= _SHOWN).tolist()

    def _in_view(
        self,
        projector: HandProjector,
        seen: SeenHand,
        keypoints: Tensor,
        silhouette: Bool[Tensor, "height width"],
    ) -> "_Compared":
        camera, model = projector.camera, projector.filled(seen.polygons)
        in_cam = camera.cam_from_world(keypoints[[0, 9]])
        focal = 0.5 * float(camera.intrinsics[0, 0] + camera.intrinsics[1, 1])
        depth = max(float(in_cam[0, 2]), 1e-3) if camera.kind == "pinhole" else 1.0
        length_px = self._length * focal / depth
        wrist, knuckle = camera.pixels_from_plane(camera.plane_from_cam(in_cam))
        has_direction = float((knuckle - wrist).norm()) > _STEEP * length_px
        if has_direction:  # the fingers' side of the wrist
            region = hand_region((camera.height, camera.width), wrist, knuckle, _REACH * length_px)
        else:
            region = dilate(model, disc_kernel(max(1, round(min(_RING * length_px, camera.width)))))
        return _Compared(
            model=model,
            picture=touching(silhouette, model),
            region=region,
            length_px=length_px,
            wrist=wrist,
            palm=0.5 * (wrist + knuckle),
            is_alone=len(self._projectors) == 1,
            towards_elbow=(wrist - knuckle) / (wrist - knuckle).norm() if has_direction else None,
        )


@dataclass(frozen=True, kw_only=True)
class _Compared:
    """A model's silhouette and a picture's, in one reduced picture."""

    model: Bool[Tensor, "height width"]
    picture: Bool[Tensor, "height width"]
    """Without what is apart from the model."""
    region: Bool[Tensor, "height width"]
    """Where the hands can be compared: on the fingers' side of the wrist, or around the model."""
    length_px: float
    """The hand's length, held parallel to the picture."""
    wrist: Float[Tensor, "2"]
    """px"""
    palm: Float[Tensor, "2"]
    """px"""
    is_alone: bool
    """Whether there is no other view, which would tell the hand from the arm."""
    towards_elbow: Float[Tensor, "2"] | None
    """Unit, in the picture; None where the palm has no direction there."""

    @property
    def overlap(self) -> float:
        return float(intersection_over_union(self.model, self.picture, self.region, empty=0.0))

    @property
    def unexplained(self) -> float:
        missed = unexplained_px(self.model, self.picture, self.region, _FINGER * self.length_px)
        return missed / self.length_px**2

    @property
    def beyond(self) -> float:
        if self.towards_elbow is None:
            return 0.0
        is_arm = self.is_alone and is_on_arm(self.picture, self.model, self.palm, self.length_px)
        parts = (self.picture, self.model, self.wrist, self.towards_elbow, self.length_px)
        return forearm_mismatch(*parts, may_be_there=not is_arm)


def mean_overlap(overlaps: Float[Tensor, "views"]) -> float:
    """Over the views that there are; 0 where there is none."""
    known = overlaps[overlaps.isfinite()]
    return float(known.mean()) if len(known) else 0.0


def _reduced(
    scene: Scene, view: int, size: tuple[int, int], device: torch.device
) -> Bool[Tensor, "height width"] | None:
    """The silhouette of a view in a reduced picture: what is probably hand in the mean over a pixel's area."""
    plane, mask = scene.probabilities[view], scene.masks[view]
    if plane is not None:
        return reduced(plane.to(device), *size) > 0.5
    return None if mask is None else reduced_mask(mask.to(device), *size)
