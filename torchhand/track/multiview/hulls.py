"""From the silhouettes of one moment to the hull that a hand is fitted into."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from torchhand.geometry import Camera
from torchhand.track.hull_points import HullTarget, target_of, with_rims
from torchhand.track.multiview.settings import HullOctreeSettings
from torchhand.track.multiview.silhouettes import Masks
from torchhand.volume import Carver, CarvingSettings, Octree, RootCube, hull_field, root_cube

_FINEST = 10
_LEAST_HULL = 3e-5  # cubic metres: what is smaller is no hand (a child's has five times that)


@dataclass(frozen=True, kw_only=True)
class Hull:
    """The hull of one moment."""

    target: HullTarget | None
    """None where there is none."""
    views: tuple[int, ...]
    """That it was carved from."""
    reason: str = ""
    """Why there is none."""


class Hulls:
    """Carves the hulls of a rig."""

    def __init__(
        self,
        cameras: Sequence[Camera],
        settings: HullOctreeSettings,
        *,
        fewest_views: int = 2,
        contours: bool = True,
    ) -> None:
        """contours: with the edges of the silhouettes.

        Raises ValueError where the cameras see no volume together and no cube is given."""
        self.cameras, self.settings, self._fewest = tuple(cameras), settings, fewest_views
        self._contours = contours
        self.root = (
            root_cube(cameras) if settings.side is None else RootCube(centre=settings.centre, side=settings.side)
        )

    def anywhere(self, masks: Masks, *, least_volume: float = _LEAST_HULL) -> Hull:
        """The hull in the whole cube, fine enough to look for a hand in it.

        least_volume: cubic metres below which there is none.
        """
        level = math.ceil(math.log2(self.root.side / self.settings.start_leaf))
        return self._hull(masks, self.root, max(1, min(_FINEST, level)), least_volume)

    def near(self, masks: Masks, place: Float[Tensor, "3"]) -> Hull:
        """The hull about a place, world frame, metres, where a hand is followed."""
        root, side = self.root, self.settings.follow
        if side is None or side >= root.side or not bool(place.isfinite().all()):
            return self._hull(masks, root, self.settings.level)
        leaf = side / 2**self.settings.level
        x, y, z = (leaf * round(float(value) / leaf) for value in place)
        return self._hull(masks, RootCube(centre=(x, y, z), side=side), self.settings.level)

    def _hull(self, masks: Masks, root: RootCube, level: int, least_volume: float = _LEAST_HULL) -> Hull:
        views = tuple(view for view, mask in enumerate(masks) if mask is not None and bool(mask.any()))
        if len(views) < self._fewest:
            missing = sum(mask is None for mask in masks)
            reason = (
                f"a silhouette in {len(views)} of {len(masks)} views ({missing} missing), {self._fewest} are needed"
            )
            return Hull(target=None, views=views, reason=reason)
        octree = self._carved(masks, views, root, level)
        if self._volume(octree) <= least_volume and len(views) > self._fewest:
            others = [tuple(v for v in views if v != left_out) for left_out in views]
            trees = [self._carved(masks, some, root, level) for some in others]
            best = max(range(len(trees)), key=lambda i: self._volume(trees[i]))
            views, octree = others[best], trees[best]
        if self._volume(octree) <= least_volume:
            return Hull(target=None, views=views, reason="the silhouettes of the views do not meet")
        target = target_of(hull_field(octree, surface="middle"))
        if not self._contours:
            return Hull(target=target, views=views)
        cameras, seen = [self.cameras[view] for view in views], [masks[view] for view in views]
        return Hull(target=with_rims(target, cameras, [mask for mask in seen if mask is not None]), views=views)

    def _carved(self, masks: Masks, views: Sequence[int], root: RootCube, level: int) -> Octree:
        s, count = self.settings, len(views)
        tolerated = min(s.tolerated_views, count - 2) if count > 2 else 0
        settings = CarvingSettings(
            level=level,
            margin_px=s.margin_px,
            tolerated_views=tolerated,
            least_views=min(s.least_views or max(2, math.ceil(0.75 * count)), count),
        )
        return Carver([self.cameras[view] for view in views], root, settings).carve([masks[view] for view in views])

    @staticmethod
    def _volume(octree: Octree) -> float:
        return float(octree.volume())
