"""From the silhouettes of one frame to the hull that a hand is fitted into."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.fit import Observation
from torchhand.fit.hull import HullTarget, target_of, with_rays
from torchhand.geometry import Camera
from torchhand.track.multiview.hand_end import HandEnd
from torchhand.track.multiview.settings import HullOctreeSettings
from torchhand.track.scene import Masks
from torchhand.volume import Carver, CarvingSettings, Octree, RootCube, hull_field, root_cube

_MAX_LEVEL = 10
_COARSE_LEAF = 0.016  # metres: leaves of the hull that tells where a hand may be
_REACH = 0.15  # metres from the middle finger's knuckle to what is no hand
_SERVES = 0.04  # metres from the place about which a hull is known to that of a hand which is fitted into it
_EXACT_TO = 0.04  # metres outside a hull that is followed: distances farther away say only that they are large
_MARGIN = 1.5  # leaves of the coarse hull that are kept about that place
_RAYS, _SPARE = 600, 2  # rays through edges, and how many times as many there are to choose from
_MIN_VOLUME = 3e-5  # cubic metres: a hull that is smaller is no hand (a child's has five times that)


@dataclass(frozen=True, kw_only=True)
class Hull:
    """The hull of one frame."""

    target: HullTarget | None
    """Target that a hand is fitted to; None where the silhouettes have no hull."""
    views: tuple[int, ...]
    """Views from which the hull was carved."""
    reason: str = ""
    """Why the silhouettes have no hull."""
    about: Float[Tensor, "3"] | None = None
    """Place about which the hull is known, world frame, metres; None where all of it is."""

    def serves(self, place: Float[Tensor, "3"]) -> bool:
        """Whether a hand at a place would be in what is known of the hull."""
        return self.about is None or is_served(self.about, place)

    def with_observations(self, observations: tuple[Observation, ...]) -> "Hull":
        """The same with what else is known of the hand at that time."""
        if self.target is None:
            return self
        return replace(self, target=replace(self.target, observations=observations))


def is_served(about: Float[Tensor, "3"], place: Float[Tensor, "3"]) -> bool:
    """Whether a hand at a place would be in what is known of a hull about another one."""
    return bool((place - about).norm() <= _SERVES)


@dataclass(frozen=True, kw_only=True)
class _Carved:
    """An octree, the views it was carved from, or why there is none."""

    views: tuple[int, ...]
    octree: Octree | None = None
    reason: str = ""


class Hulls:
    """Carves the hulls of a rig."""

    def __init__(
        self,
        cameras: Sequence[Camera],
        settings: HullOctreeSettings,
        *,
        min_views: int = 2,
    ) -> None:
        """Raises ValueError where the cameras see no volume together and no cube is given."""
        self.cameras, self.settings, self._min_views = tuple(cameras), settings, min_views
        self._carvers: dict[tuple[tuple[int, ...], float, CarvingSettings], Carver] = {}
        self.root = (
            root_cube(cameras) if settings.side is None else RootCube(centre=settings.centre, side=settings.side)
        )

    def anywhere(self, masks: Masks, *, hand_length: float | None = None, min_volume: float = _MIN_VOLUME) -> Hull:
        """The hull in the whole cube, fine enough to look for a hand in it.

        hand_length: metres; then only what may be a hand at the end of an arm. min_volume: cubic metres below which
        there is no hull.
        """
        if hand_length is None:
            level = math.ceil(math.log2(self.root.side / self.settings.start_leaf))
            return self._hull(masks, self.root, max(1, min(_MAX_LEVEL, level)), min_volume)
        level = max(1, math.ceil(math.log2(self.root.side / _COARSE_LEAF)))
        carved = self._carved(masks, self.root, level, min_volume)
        if carved.octree is None:
            return Hull(target=None, views=carved.views, reason=carved.reason)
        kept = [mask if view in carved.views else None for view, mask in enumerate(masks)]
        end = HandEnd(self.cameras, kept, hand_length)
        return self._hull(kept, self._cube_of(end, carved.octree), self.settings.level, min_volume, end)

    def _cube_of(self, end: HandEnd, octree: Octree) -> RootCube:
        """A cube around what may be a hand; the whole one where nothing may."""
        filled, first = octree.occupancy()
        corner = torch.tensor(self.root.corner, dtype=torch.float64, device=filled.device)
        places = corner + octree.leaf_side * (filled.nonzero() + filled.new_tensor(first, dtype=torch.long) + 0.5)
        places = places[end(places)]
        if not len(places):
            return self.root
        margin = _MARGIN * octree.leaf_side
        low, high = places.amin(0) - margin, places.amax(0) + margin
        x, y, z = (0.5 * (low + high)).tolist()
        return RootCube(centre=(x, y, z), side=min(self.root.side, float((high - low).max())))

    def near(self, masks: Masks, place: Float[Tensor, "3"]) -> Hull:
        """The hull about a place, world frame, metres, where a hand is followed.

        A hand that leaves pictures is where the others see it: what lies beyond the border of a picture is the hull's
        if fewer views see it than are needed elsewhere, as many as show all about the place; one at least.
        """
        root, side = self.root, self.settings.tracked_side
        if side is None or side >= root.side or not bool(place.isfinite().all()):
            return self._hull(masks, root, self.settings.level)
        leaf = side / 2**self.settings.level
        x, y, z = (leaf * round(float(value) / leaf) for value in place)
        cube = RootCube(centre=(x, y, z), side=side)
        return replace(self._hull(masks, cube, self.settings.level, about=place), about=place)

    def _hull(
        self,
        masks: Masks,
        root: RootCube,
        level: int,
        min_volume: float = _MIN_VOLUME,
        end: HandEnd | None = None,
        about: Float[Tensor, "3"] | None = None,
    ) -> Hull:
        """about: the place of a hand, about which alone the hull is wanted."""
        carved = self._carved(masks, root, level, min_volume, about)
        if carved.octree is None:
            return Hull(target=None, views=carved.views, reason=carved.reason)
        within = None if about is None else (root.centre, _REACH)
        exact_to = math.inf if about is None else _EXACT_TO
        target = target_of(hull_field(carved.octree, surface="middle", within=within, exact_to=exact_to))
        if end is not None:
            target = target.where(end)
        cameras, seen = [self.cameras[view] for view in carved.views], [masks[view] for view in carved.views]
        target = with_rays(target, cameras, seen, count=_RAYS if end is None else _SPARE * _RAYS)
        if end is not None and target.rays is not None:
            target = replace(target, rays=end.rays(target.rays, _RAYS))
        return Hull(target=target, views=carved.views)

    def _carved(
        self,
        masks: Masks,
        root: RootCube,
        level: int,
        min_volume: float,
        about: Float[Tensor, "3"] | None = None,
    ) -> "_Carved":
        """An octree from all views or, where these do not meet, from all but the one without which most is left."""
        views = tuple(view for view, mask in enumerate(masks) if mask is not None and bool(mask.any()))
        least = self._min_views
        if len(views) < least and about is not None:
            least = max(1, min(least, _number_about(self.cameras, about)))
        if len(views) < least:
            missing = sum(mask is None for mask in masks)
            reason = f"a silhouette in {len(views)} of {len(masks)} views ({missing} missing), {least} are needed"
            return _Carved(views=views, reason=reason)
        octree = self._octree(masks, views, root, level, about)
        if float(octree.volume()) <= min_volume and len(views) > self._min_views:
            others = [tuple(v for v in views if v != left_out) for left_out in views]
            trees = [self._octree(masks, some, root, level, about) for some in others]
            best = max(range(len(trees)), key=lambda i: float(trees[i].volume()))
            views, octree = others[best], trees[best]
        if float(octree.volume()) <= min_volume:
            return _Carved(views=views, reason="the silhouettes of the views do not meet")
        return _Carved(views=views, octree=octree)

    def _octree(
        self,
        masks: Masks,
        views: Sequence[int],
        root: RootCube,
        level: int,
        about: Float[Tensor, "3"] | None,
    ) -> Octree:
        s, count = self.settings, len(views)
        tolerated = min(s.tolerated_views, count - 2) if count > 2 else 0
        needed = min(s.min_views or max(2, math.ceil(0.75 * count)), count)
        if about is not None and s.min_views is None:
            needed = max(1, min(needed, _number_about([self.cameras[view] for view in views], about)))
        settings = CarvingSettings(
            level=level,
            margin_px=s.margin_px,
            tolerated_views=tolerated,
            min_views=needed,
        )
        return self._carver(tuple(views), root, settings).carve([masks[view] for view in views])

    def _carver(self, views: tuple[int, ...], root: RootCube, settings: CarvingSettings) -> Carver:
        """The carver of some views and a cube; those of the cubes that come again and again are kept."""
        key = (views, root.side, settings)
        if key in self._carvers:
            return self._carvers[key].moved(root)
        made = Carver([self.cameras[view] for view in views], root, settings)
        if root.side in (self.root.side, self.settings.tracked_side):
            self._carvers[key] = made
        return made


def _number_about(cameras: Sequence[Camera], place: Float[Tensor, "3"]) -> int:
    """In how many pictures a hand about a place, world frame, is as a whole, whatever its posture."""
    return sum(_shows_all_about(camera, place) for camera in cameras)


def _shows_all_about(camera: Camera, place: Float[Tensor, "3"]) -> bool:
    """Whether a hand about a place, world frame, is in the picture whatever its posture."""
    *at, depth = camera.cam_from_world(place).tolist()
    depth = depth if camera.kind == "pinhole" else 1.0
    if not depth > 0:
        return False
    (focal_x, _, centre_x), (_, focal_y, centre_y), _ = camera.intrinsics.tolist()
    sides = ((at[0], focal_x, centre_x, camera.width), (at[1], focal_y, centre_y, camera.height))
    return all(
        focal * _REACH / depth <= focal * middle / depth + centre <= size - 1 - focal * _REACH / depth
        for middle, focal, centre, size in sides
    )
