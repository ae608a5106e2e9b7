"""Getting to know a hand before it is followed: where it is in some moments, and its proportions over all of them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.hand import Anthropometry
from torchhand.track.hull_points import HullTarget
from torchhand.track.hull_shape import fit_shape
from torchhand.track.multiview.silhouettes import Masks
from torchhand.track.multiview.tracker import Anchor, MultiViewTracker, Placed

_NEARLY = 0.02  # overlap that a hand followed from another moment may lack for one found afresh
_WORST = 0.10  # overlap that a moment may lack for the best one and still teach proportions


@dataclass(frozen=True, kw_only=True)
class Acquaintance:
    """A hand as some moments show it."""

    shape: Float[Tensor, "shape"]
    shape_std: Float[Tensor, "shape"] | None
    """None where the proportions were given or nothing could be learned."""
    anchors: Mapping[int, Anchor]
    """Where the hand was found, by moment."""
    learned_from: tuple[int, ...]
    """The moments that taught the proportions."""


@dataclass(frozen=True, kw_only=True)
class _Seen:
    """A moment in which the hand was found."""

    moment: int
    target: HullTarget
    placed: Placed

    @property
    def anchor(self) -> Anchor:
        return Anchor(pose=self.placed.fit.pose, root_reference=self.placed.fit.root_reference)


def moments_of(count: int, frames: int) -> tuple[int, ...]:
    """At most `frames` moments of `count`, evenly over them."""
    if frames <= 0 or count <= 0:
        return ()
    wanted = min(frames, count)
    return tuple(sorted({round((i + 0.5) * count / wanted - 0.5) for i in range(wanted)}))


def acquaint(
    tracker: MultiViewTracker,
    moments: Sequence[tuple[int, Masks]],
    people: Anthropometry,
    *,
    shape: Float[Tensor, "shape"] | None = None,
    done: Callable[[], object] = lambda: None,
) -> Acquaintance:
    """Find the hand in the moments, and fit its proportions to all those in which it was found well.

    shape: known proportions, which are then only used. done: called after every moment.

    Without any moment in which a hand is found the proportions are the generic hand's, or those given.
    """
    seen: list[_Seen] = []
    own = shape
    for moment, masks in moments:
        found = _found(tracker, moment, masks, own, seen)
        if found is not None:
            if own is None:
                own = _fitted(tracker, [found], people).shape
                again = tracker.anchored(found.anchor, own, masks)
                found = found if again is None else _Seen(moment=moment, target=found.target, placed=again)
            seen.append(found)
        done()
    generic = tracker.hand.kinematics.default_shape if own is None else own
    if not seen:
        return Acquaintance(shape=generic, shape_std=None, anchors={}, learned_from=())
    anchors = {one.moment: one.anchor for one in seen}
    if shape is not None:
        return Acquaintance(shape=shape, shape_std=None, anchors=anchors, learned_from=())
    best = max(one.placed.overlap for one in seen)
    good = [one for one in seen if one.placed.overlap >= best - _WORST]
    fit = _fitted(tracker, good, people, generic)
    poses = zip(good, fit.pose, fit.root_reference, strict=True)
    anchors |= {one.moment: Anchor(pose=pose, root_reference=reference) for one, pose, reference in poses}
    return Acquaintance(
        shape=fit.shape,
        shape_std=fit.shape_std,
        anchors=anchors,
        learned_from=tuple(one.moment for one in good),
    )


def _found(
    tracker: MultiViewTracker, moment: int, masks: Masks, shape: Tensor | None, seen: Sequence[_Seen]
) -> _Seen | None:
    """The hand followed from the moment before, where that explains as much as was ever found; else searched."""
    hull = tracker.hulls.anywhere(masks)
    if hull.target is None:
        return None
    placed = None
    if shape is not None and seen:
        usual = max(one.placed.overlap for one in seen)
        placed = tracker.anchored(seen[-1].anchor, shape, masks)
        if placed is not None and placed.overlap >= usual - _NEARLY:
            return _Seen(moment=moment, target=hull.target, placed=placed)
    sizes = _sizes(tracker) if shape is None else [shape]
    tried = [placed, *(tracker.searched(hull, size, masks) for size in sizes)]
    best = max((one for one in tried if one is not None), key=lambda one: one.overlap, default=None)
    if best is None or best.overlap < tracker.settings.loss.start_overlap:
        return None
    return _Seen(moment=moment, target=hull.target, placed=best)


def _sizes(tracker: MultiViewTracker) -> list[Tensor]:
    """The generic hand in several sizes."""
    space = tracker.hand.kinematics.shape_space
    metric = torch.tensor([unit == "m" for unit in space.units])
    default = space.default.to(torch.float64)
    scaled = [torch.where(metric, size * default, default) for size in tracker.settings.sizes]
    return [shape.clamp(space.lower.to(shape), space.upper.to(shape)) for shape in scaled]


def _fitted(tracker: MultiViewTracker, seen: Sequence[_Seen], people: Anthropometry, shape: Tensor | None = None):
    settings = tracker.settings
    return fit_shape(
        [one.target for one in seen],
        tracker.hand,
        tracker.space,
        torch.stack([one.placed.fit.pose for one in seen]),
        torch.stack([one.placed.fit.root_reference for one in seen]),
        people,
        settings.shape,
        settings.start_fit,
        shape=shape,
        **tracker.beliefs,
    )
