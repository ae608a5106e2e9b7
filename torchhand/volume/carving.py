"""Hulls from silhouettes: an octree carved level by level (Ueda et al. 2003, 3.2; Szeliski 1993)."""

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from torchhand.geometry import Camera
from torchhand.volume.carving_settings import DENSE_LEVELS, CarvingSettings
from torchhand.volume.cube import RootCube, root_cube
from torchhand.volume.octant_views import OctantViews
from torchhand.volume.octree import GRAY, UNKNOWN, WHITE, Octree, OctreeLevel, places_of
from torchhand.volume.silhouettes import SumTables

_AT_ONCE = 1 << 15  # octants times views tested together: what they need stays in the processor's cache

Masks = Sequence[Bool[Tensor, "*batch _height _width"] | None]
"""One per camera, of its picture's size; None where the view is missing in all frames."""


class Carver:
    """Carves hulls for a fixed rig, on the device of the cameras.

    root: the cube to divide; the smallest around what all cameras see together where it is None (`root_cube`).

    Raises ValueError for no cameras, for too many tolerated views, and where the cameras see no volume together and no
    root is given.
    """

    def __init__(
        self, cameras: Sequence[Camera], root: RootCube | None = None, settings: CarvingSettings | None = None
    ) -> None:
        self.settings = settings = settings or CarvingSettings()
        if not 1 <= len(cameras) <= 255:
            raise ValueError(f"cameras: expected 1 to 255, got {len(cameras)}")
        if settings.tolerated_views >= len(cameras):
            raise ValueError(
                f"tolerated_views: expected fewer than the {len(cameras)} cameras, got {settings.tolerated_views}"
            )
        self.cameras = tuple(cameras)
        self.root = root_cube(cameras) if root is None else root
        self._device = cameras[0].rotation.device
        self._views = {tuple(range(len(cameras))): self._seen_by(cameras)}
        self._min_views = min(settings.min_views, len(cameras) - settings.tolerated_views)
        self._children = torch.cartesian_prod(*3 * [torch.arange(2.0)]).T.contiguous().to(self._device)
        self._coarse = torch.zeros(3, 1, device=self._device)
        for _ in range(min(DENSE_LEVELS, settings.level)):
            self._coarse = self._divided(self._coarse)

    def carve(self, masks: Masks, is_there: Bool[Tensor, "*batch views"] | None = None) -> Octree:
        """The hulls of a batch of frames.

        masks: True where the object is seen; pixels outside the picture are not known, never background.
        is_there: False for views that are missing or not to be trusted in single frames; they carve nothing away.

        Silhouettes that do not meet give a frame without hull (`Octree.is_empty`).

        Raises ValueError where the number of masks, their sizes or their batches do not fit the cameras.
        """
        batch = self._checked(masks, is_there)
        with torch.no_grad():
            levels = self._levels(self._silhouettes(masks, is_there))
        return Octree(root=self.root, batch=batch, levels=tuple(levels))

    def moved(self, root: RootCube) -> "Carver":
        """The carver for another cube of the same size, such as one that follows something; quick.

        Raises ValueError for one of another size.
        """
        if root.side != self.root.side:
            raise ValueError(f"root: expected a side of {self.root.side} m, got {root.side} m")
        carver = copy.copy(self)
        carver.root, carver._views = root, {chosen: views.moved(root) for chosen, views in self._views.items()}
        return carver

    def dense(
        self, masks: Masks, is_there: Bool[Tensor, "*batch views"] | None = None
    ) -> UInt8[Tensor, "*batch n n n"]:
        """The states of all finest octants, each by its own test alone; n is 2**level, the axes are x, y and z.

        The plain version of `carve`, with the same hull; it takes 8**level tests per view and frame.
        """
        batch = self._checked(masks, is_there)
        level, n = self.settings.level, 2**self.settings.level
        with torch.no_grad():
            seen = self._silhouettes(masks, is_there)
            along = torch.arange(float(n), device=self._device)
            plane = torch.cartesian_prod(along[:1], along, along).T.contiguous()
            states = []
            for frame in torch.arange(len(seen.tables.entries), device=self._device):
                for x in range(n):
                    plane[0] = x
                    states.append(self._states(seen, plane, frame.expand(n * n), level))
        return torch.cat(states).reshape(*batch, n, n, n)

    def _checked(self, masks: Masks, is_there: Tensor | None) -> tuple[int, ...]:
        """The batch dimensions, once everything fits."""
        if len(masks) != len(self.cameras):
            raise ValueError(f"masks: expected {len(self.cameras)}, one per camera, got {len(masks)}")
        batch: tuple[int, ...] | None = None
        for index, (mask, camera) in enumerate(zip(masks, self.cameras, strict=True)):
            if mask is None:
                continue
            height, width = mask.shape[-2:]
            if (width, height) != (camera.width, camera.height):
                raise ValueError(
                    f"masks[{index}]: expected {camera.width}x{camera.height} px, the size of camera {camera.name!r},"
                    f" got {width}x{height}"
                )
            own = tuple(mask.shape[:-2])
            if batch is not None and own != batch:
                raise ValueError(f"masks[{index}]: expected the batch {batch} of the views before it, got {own}")
            batch = own
        if batch is None:
            raise ValueError("masks: expected at least one view, got none")
        if is_there is not None and is_there.shape != (*batch, len(masks)):
            raise ValueError(f"is_there: expected the shape {(*batch, len(masks))}, got {tuple(is_there.shape)}")
        return batch

    def _silhouettes(self, masks: Masks, is_there: Tensor | None) -> "_Silhouettes":
        """Silhouettes of the views that there are."""
        chosen = tuple(index for index, mask in enumerate(masks) if mask is not None)
        if chosen not in self._views:
            self._views[chosen] = self._seen_by([self.cameras[index] for index in chosen])
        flat = [mask.to(self._device).reshape(-1, *mask.shape[-2:]) for mask in masks if mask is not None]
        views = self._views[chosen]
        there = None if is_there is None else is_there.to(self._device).reshape(-1, len(masks)).T[list(chosen)]
        if there is not None and bool(there.all()):
            there = None
        return _Silhouettes(views=views, count=len(chosen), tables=views.tables(flat), is_there=there)

    def _seen_by(self, cameras: Sequence[Camera]) -> OctantViews:
        margin_px, level = self.settings.margin_px, self.settings.level
        return OctantViews(cameras, self.root, margin_px=margin_px, levels=level, device=self._device)

    def _levels(self, seen: "_Silhouettes") -> list[OctreeLevel]:
        coarse, frame_count = min(DENSE_LEVELS, self.settings.level), len(seen.tables.entries)
        cells = self._coarse.repeat(1, frame_count)
        frames = torch.arange(frame_count, dtype=torch.int32, device=self._device).repeat_interleave(8**coarse)
        levels = _merged(cells, self._states(seen, cells, frames, coarse), frames, coarse)
        cells, states, frames = levels[-1].cells.T.float(), levels[-1].states, levels[-1].frames
        for level in range(coarse + 1, self.settings.level + 1):
            gray = places_of(states == GRAY)
            if 8 * len(gray) > self.settings.max_octants:
                break
            cells = self._divided(cells.index_select(1, gray))
            frames = frames.index_select(0, gray)[:, None].expand(-1, 8).reshape(-1)
            states = self._states(seen, cells, frames, level)
            levels.append(_level(level, cells, states, frames))
        return levels

    def _divided(self, cells: Float[Tensor, "3 octants"]) -> Float[Tensor, "3 children"]:
        return (2 * cells[:, :, None] + self._children[:, None, :]).reshape(3, -1)

    def _states(
        self, seen: "_Silhouettes", cells: Float[Tensor, "3 octants"], frames: Int[Tensor, "octants"], level: int
    ) -> UInt8[Tensor, "octants"]:
        """The state of every octant; what is certain of one is certain of all that it divides into."""
        states = torch.empty(frames.shape, dtype=torch.uint8, device=self._device)
        tolerated, together = self.settings.tolerated_views, _AT_ONCE // seen.count
        is_single = len(seen.tables.entries) == 1
        for start in range(0, len(frames), together):
            some = slice(start, start + together)
            of_frame = None if is_single else frames[some]
            found = seen.views.verdicts(cells[:, some], level, seen.tables, of_frame, seen.is_there)
            against = _number((found.is_in | found.is_unseen).logical_not_())
            is_black = (against <= tolerated).logical_and_(_number(found.is_in) >= self._min_views)
            state = is_black.to(torch.uint8).add_(GRAY)  # or BLACK
            state.masked_fill_(_number(found.is_bare) > seen.count - self._min_views, UNKNOWN)
            states[some] = state.masked_fill_(_number(found.is_out) > tolerated, WHITE)
        return states


@dataclass(frozen=True, kw_only=True)
class _Silhouettes:
    """The views that there are."""

    views: OctantViews
    count: int
    tables: SumTables
    is_there: Bool[Tensor, "views frames"] | None
    """The views that are not missing in a frame; None where none is."""


def carve(
    masks: Masks,
    cameras: Sequence[Camera],
    root: RootCube | None = None,
    settings: CarvingSettings | None = None,
    *,
    is_there: Bool[Tensor, "*batch views"] | None = None,
) -> Octree:
    """The hulls of a batch of frames: `Carver(cameras, root, settings).carve(masks, is_there)`, see there."""
    return Carver(cameras, root, settings).carve(masks, is_there)


def _merged(
    cells: Float[Tensor, "3 octants"], states: UInt8[Tensor, "octants"], frames: Int[Tensor, "octants"], level: int
) -> list[OctreeLevel]:
    """Levels 0 to `level` from all octants of the last: eight that are alike are one, and not divided."""
    whole = [(cells, states, frames)]
    for _ in range(level):
        cells, frames, eight = (cells[:, ::8] / 2).floor(), frames[::8], whole[0][1].reshape(-1, 8)
        is_alike = (eight == eight[:, :1]).all(-1)
        whole.insert(0, (cells, eight[:, 0].masked_fill(is_alike.logical_not(), GRAY), frames))
    levels, is_kept = [], torch.ones_like(whole[0][1], dtype=torch.bool)
    for depth, (cells, states, frames) in enumerate(whole):
        kept = places_of(is_kept)
        levels.append(_level(depth, cells.index_select(1, kept), states[kept], frames[kept]))
        is_kept = (is_kept & (states == GRAY))[:, None].expand(-1, 8).reshape(-1)
    return levels


def _level(level: int, cells: Tensor, states: Tensor, frames: Tensor) -> OctreeLevel:
    return OctreeLevel(level=level, cells=cells.to(torch.int16).T, states=states, frames=frames)


def _number(verdicts: Bool[Tensor, "views n"]) -> Int[Tensor, "n"]:
    """Number of views, for every octant."""
    return verdicts.sum(0, dtype=torch.int16)
