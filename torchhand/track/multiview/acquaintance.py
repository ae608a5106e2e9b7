"""Getting to know a hand before it is followed: where it is in some moments, and its proportions over all of them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.fit import SharedSolution
from torchhand.fit.hull import HullTarget, fit_shape
from torchhand.hand import Anthropometry, HandPose
from torchhand.track.multiview.continuity import most_consistent
from torchhand.track.multiview.fitting import Anchor, MomentFitter, Placed, chosen
from torchhand.track.multiview.hulls import Hull
from torchhand.track.scene import Masks

_NEARLY = 0.03  # score that a hand followed from other moments may lack for one found afresh
_WORST = 0.08  # score that a moment may lack for the best one and still teach proportions
_UNLIKELY = 0.15  # score that a moment may lack for the best one and still count as found
_COST = 1e-3  # score that a unit of a fit's cost is worth between ways that explain alike
_CLEAREST = 4  # moments that teach the first proportions
_MOST = 8  # hands of other moments that are tried


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
    """A moment, and the hand in it where it was found."""

    moment: int
    masks: Masks
    hull: Hull
    placed: Placed | None = None

    def at(self, placed: Placed | None) -> "_Seen":
        return _Seen(moment=self.moment, masks=self.masks, hull=self.hull, placed=placed)


def moments_of(count: int, frames: int) -> tuple[int, ...]:
    """At most `frames` moments of `count`, evenly over them."""
    if frames <= 0 or count <= 0:
        return ()
    wanted = min(frames, count)
    return tuple(sorted({round((i + 0.5) * count / wanted - 0.5) for i in range(wanted)}))


def acquaint(
    fits: MomentFitter,
    moments: Sequence[tuple[int, Masks]],
    people: Anthropometry,
    *,
    shape: Float[Tensor, "shape"] | None = None,
    done: Callable[[], object] = lambda: None,
) -> Acquaintance:
    """Find the hand in the moments, and fit its proportions to all those in which it was found well.

    First every moment by itself, or from the hands of those before where these do as well; then with the proportions
    that the clearest tell together from all of them, such that they agree about how the hand faces, and the
    proportions once more.

    shape: known proportions, which are then only used. done: called after every moment.

    Without any moment in which a hand is found the proportions are the generic hand's, or those given.
    """
    seen: list[_Seen] = []
    for moment, masks in moments:
        one = _Seen(moment=moment, masks=masks, hull=fits.hull_anywhere(shape, masks))
        seen.append(one.at(_found(fits, one, shape, _anchors_of(seen))))
        done()
    if not _anchors_of(seen):
        generic = fits.hand.kinematics.default_shape if shape is None else shape
        return Acquaintance(shape=generic, shape_std=None, anchors={}, learned_from=())
    own = shape
    if own is None:
        clearest = sorted(_good(seen), key=lambda one: -one.placed.score if one.placed else 0.0)[:_CLEAREST]
        own = _fitted(fits, clearest, people, rough=True).shape
    seen = [one.at(_again(fits, one, own, _anchors_of(seen))) for one in seen]
    seen = _agreed(fits, seen, own)
    anchors = {one.moment: one.placed.anchor for one in _within(seen, _UNLIKELY) if one.placed is not None}
    if shape is not None:
        return Acquaintance(shape=shape, shape_std=None, anchors=anchors, learned_from=())
    good = _good(seen)
    fit = _fitted(fits, good, people, own)
    poses = zip(good, fit.pose.dofs, fit.pose.reference, strict=True)
    anchors |= {one.moment: Anchor(pose=pose, root_reference=reference) for one, pose, reference in poses}
    return Acquaintance(
        shape=fit.shape,
        shape_std=fit.shape_std,
        anchors=anchors,
        learned_from=tuple(one.moment for one in good),
    )


def _found(fits: MomentFitter, one: _Seen, shape: Tensor | None, anchors: Sequence[tuple[Anchor, float]]):
    """The hand from those of other moments, where that explains as much as was ever found; else searched."""
    if one.hull.target is None:
        return None
    near: Placed | None = None
    sizes = _sizes(fits) if shape is None else [shape]
    if len(sizes) == 1 and anchors:
        near = fits.from_anchors(one.hull, [anchor for anchor, _ in anchors[-_MOST:]], sizes[0], one.masks)
        if near is not None and near.score >= max(score for _, score in anchors) - _NEARLY:
            return near
    return _believed(fits, chosen([near, *(fits.searched(one.hull, size, one.masks) for size in sizes)]))


def _again(fits: MomentFitter, one: _Seen, shape: Tensor, anchors: Sequence[tuple[Anchor, float]]) -> Placed | None:
    """With better proportions: from the hand that was found and, where that is doubtful, from those of others."""
    if one.hull.target is None:
        return None
    best = [anchor for anchor, _ in sorted(anchors, key=lambda pair: -pair[1])[:_MOST]]

    def varied(placed: Placed | None) -> Placed | None:
        if placed is None:
            return None
        other = fits.with_other_digits(one.hull, placed.anchor, best, shape, one.masks)
        return chosen([placed, other and fits.settled(one.hull, other.anchor, shape, one.masks)])

    own = None
    if one.placed is not None:
        own = varied(fits.settled(one.hull, one.placed.anchor, shape, one.masks))
        if own is not None and own.score >= max(score for _, score in anchors) - _NEARLY:
            return own
    tried = [own, fits.from_anchors(one.hull, best, shape, one.masks), fits.searched(one.hull, shape, one.masks)]
    return _believed(fits, varied(chosen(tried)))


def _agreed(fits: MomentFitter, seen: Sequence[_Seen], shape: Tensor) -> list[_Seen]:
    """Every moment explained so that the hand faces alike in those that follow each other, where both ways will do."""
    found = [(place, one, one.placed) for place, one in enumerate(seen) if one.placed is not None]
    ways = []
    for _, one, placed in found:
        others = [other.anchor for _, _, other in found if other is not placed]
        ways.append([placed, *fits.in_place(one.hull, placed.anchor, others, shape, one.masks)])
    scores = [torch.tensor([way.score - _COST * float(way.fit.cost) for way in own]) for own in ways]
    facing = [torch.stack([way.fit.root_reference for way in own]) for own in ways]
    agreed = list(seen)
    for (place, one, _), own, way in zip(found, ways, most_consistent(scores, facing), strict=True):
        agreed[place] = one.at(own[way])
    return agreed


def _believed(fits: MomentFitter, placed: Placed | None) -> Placed | None:
    return None if placed is None or placed.overlap < fits.settings.found_overlap else placed


def _anchors_of(seen: Sequence[_Seen]) -> list[tuple[Anchor, float]]:
    """The hands that were found, with their scores."""
    return [(one.placed.anchor, one.placed.score) for one in seen if one.placed is not None]


def _good(seen: Sequence[_Seen]) -> list[_Seen]:
    """The moments that may teach proportions."""
    return _within(seen, _WORST)


def _within(seen: Sequence[_Seen], lack: float) -> list[_Seen]:
    """The moments whose score lacks no more for the best one."""
    best = max(one.placed.score for one in seen if one.placed is not None)
    return [one for one in seen if one.placed is not None and one.placed.score >= best - lack]


def _sizes(fits: MomentFitter) -> list[Tensor]:
    """The generic hand in several sizes."""
    space = fits.hand.kinematics.shape_space
    metric = torch.tensor([unit == "m" for unit in space.units])
    default = space.default.to(torch.float64)
    scaled = [torch.where(metric, size * default, default) for size in fits.settings.sizes]
    return [shape.clamp(space.lower.to(shape), space.upper.to(shape)) for shape in scaled]


def _fitted(
    fits: MomentFitter,
    seen: Sequence[_Seen],
    people: Anthropometry,
    shape: Tensor | None = None,
    *,
    rough: bool = False,
) -> SharedSolution:
    """rough: with half the rounds, where more will follow."""
    settings = fits.settings.shape
    if rough:
        settings = replace(settings, rounds=max(1, settings.rounds // 2))
    found: list[tuple[HullTarget, Placed]] = [
        (one.hull.target, one.placed) for one in seen if one.hull.target is not None and one.placed is not None
    ]
    starts = HandPose(
        dofs=torch.stack([placed.fit.pose for _, placed in found]),
        reference=torch.stack([placed.fit.root_reference for _, placed in found]),
    )
    return fit_shape(fits.shape_fitter(shape), [target for target, _ in found], starts, people, settings)
