"""The hand before it is followed: its pose in some frames of a recording, and its proportions over all of them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.fit import SharedSolution
from torchhand.fit.hull import HullTarget, fit_shape
from torchhand.hand import Anthropometry, HandPose
from torchhand.track.multiview.continuity import viterbi_path
from torchhand.track.multiview.fitting import FrameFitter, HullFit, best_of
from torchhand.track.multiview.hulls import Hull
from torchhand.track.scene import Masks

_MAX_DROP_WITHOUT_SEARCH = 0.03  # score below the best frame's with which a frame needs no search
_MAX_DROP_FOR_SHAPE = 0.08  # score below the best frame's with which a frame enters the fit of the proportions
_MAX_DROP_AS_FOUND = 0.15  # score below the best frame's with which a hand still counts as found
_SCORE_PER_NAT = 1e-3  # score that a nat of a fit's cost is worth between fits that explain a frame alike
_FIRST_SHAPE_FRAMES = 4  # frames of the highest scores, to which the first proportions are fitted
_MAX_POSES = 8  # poses of other frames that are tried as starts


@dataclass(frozen=True, kw_only=True)
class HandInitialization:
    """A hand as some frames show it."""

    shape: Float[Tensor, "shape"]
    """Proportions: those fitted, those given, or the generic hand's where no hand was found."""
    shape_std: Float[Tensor, "shape"] | None
    """Standard deviations of the proportions; None where these were given or could not be fitted."""
    poses: Mapping[int, HandPose]
    """Poses with a zero rotation vector, world frame, by the index of the frame in which the hand was found."""
    shape_frames: tuple[int, ...]
    """Indices of the frames to which the proportions were fitted."""


@dataclass(frozen=True, kw_only=True)
class _Frame:
    """A frame, and the hand in it where it was found."""

    index: int
    masks: Masks
    hull: Hull
    fit: HullFit | None = None


def evenly_spaced_frames(count: int, wanted: int) -> tuple[int, ...]:
    """Indices of at most `wanted` frames of `count`, evenly over them."""
    if wanted <= 0 or count <= 0:
        return ()
    size = min(wanted, count)
    return tuple(sorted({round((i + 0.5) * count / size - 0.5) for i in range(size)}))


def initialize_hand(
    fitter: FrameFitter,
    frames: Sequence[tuple[int, Masks]],
    population: Anthropometry,
    *,
    shape: Float[Tensor, "shape"] | None = None,
    done: Callable[[], object] = lambda: None,
) -> HandInitialization:
    """Find the hand in the frames, and fit its proportions to all those in which it was found well.

    First every frame is fitted by itself, or from the poses of the frames before where these do as well; then, with
    the proportions that fit the clearest frames together, from all of them, such that they agree about how the hand
    faces; then the proportions are fitted once more.

    shape: known proportions, which are then only used. done: called after every frame.

    Without any frame in which a hand is found the proportions are the generic hand's, or those given.
    """
    seen: list[_Frame] = []
    for index, masks in frames:
        frame = _Frame(index=index, masks=masks, hull=fitter.hull_anywhere(shape, masks))
        seen.append(replace(frame, fit=_found(fitter, frame, shape, _fits_of(seen))))
        done()
    if not _fits_of(seen):
        generic = fitter.hand.kinematics.default_shape if shape is None else shape
        return HandInitialization(shape=generic, shape_std=None, poses={}, shape_frames=())
    own = shape
    if own is None:
        clearest = sorted(_for_shape(seen), key=lambda frame: -frame.fit.score if frame.fit else 0.0)
        own = _shape_fit(fitter, clearest[:_FIRST_SHAPE_FRAMES], population, is_rough=True).shape
    seen = [replace(frame, fit=_refined(fitter, frame, own, _fits_of(seen))) for frame in seen]
    seen = _consistent(fitter, seen, own)
    poses = {frame.index: frame.fit.pose for frame in _within(seen, _MAX_DROP_AS_FOUND) if frame.fit is not None}
    if shape is not None:
        return HandInitialization(shape=shape, shape_std=None, poses=poses, shape_frames=())
    good = _for_shape(seen)
    solution = _shape_fit(fitter, good, population, own)
    poses |= {frame.index: solution.pose[place] for place, frame in enumerate(good)}
    return HandInitialization(
        shape=solution.shape,
        shape_std=solution.shape_std,
        poses=poses,
        shape_frames=tuple(frame.index for frame in good),
    )


def _found(fitter: FrameFitter, frame: _Frame, shape: Tensor | None, fits: Sequence[HullFit]) -> HullFit | None:
    """The hand from the poses of other frames, where that explains as much as was ever found; else searched."""
    if frame.hull.target is None:
        return None
    near: HullFit | None = None
    sizes = _scaled_shapes(fitter) if shape is None else [shape]
    if len(sizes) == 1 and fits:
        near = fitter.fit_from(frame.hull, [fit.pose for fit in fits[-_MAX_POSES:]], sizes[0], frame.masks)
        if near is not None and near.score >= _required_score(fits):
            return near
    searched = [fitter.search(frame.hull, size, frame.masks) for size in sizes]
    return _accepted(fitter, best_of([near, *searched]))


def _refined(fitter: FrameFitter, frame: _Frame, shape: Tensor, fits: Sequence[HullFit]) -> HullFit | None:
    """The hand with better proportions: from the hand that was found and, where its score is low, from those of other
    frames."""
    if frame.hull.target is None:
        return None
    best = [fit.pose for fit in sorted(fits, key=lambda fit: -fit.score)[:_MAX_POSES]]

    def with_alternatives(fit: HullFit | None) -> HullFit | None:
        if fit is None:
            return None
        other = fitter.vary_fingers(frame.hull, fit.pose, best, shape, frame.masks)
        return best_of([fit, other and fitter.refine(frame.hull, other.pose, shape, frame.masks)])

    own = None
    if frame.fit is not None:
        own = with_alternatives(fitter.refine(frame.hull, frame.fit.pose, shape, frame.masks))
        if own is not None and own.score >= _required_score(fits):
            return own
    near = fitter.fit_from(frame.hull, best, shape, frame.masks)
    tried = [own, near, fitter.search(frame.hull, shape, frame.masks)]
    return _accepted(fitter, with_alternatives(best_of(tried)))


def _consistent(fitter: FrameFitter, seen: Sequence[_Frame], shape: Tensor) -> list[_Frame]:
    """Every frame explained so that the hand faces alike in those that follow each other, where both ways will do."""
    found = [(place, frame, frame.fit) for place, frame in enumerate(seen) if frame.fit is not None]
    alternatives = []
    for _, frame, fit in found:
        others = [other.pose for _, _, other in found if other is not fit]
        alternatives.append([fit, *fitter.fit_in_place(frame.hull, fit.pose, others, shape, frame.masks)])
    scores = [torch.tensor([fit.score - _SCORE_PER_NAT * float(fit.cost) for fit in own]) for own in alternatives]
    facing = [torch.stack([fit.pose.reference for fit in own]) for own in alternatives]
    chosen = list(seen)
    for (place, frame, _), own, index in zip(found, alternatives, viterbi_path(scores, facing), strict=True):
        chosen[place] = replace(frame, fit=own[index])
    return chosen


def _accepted(fitter: FrameFitter, fit: HullFit | None) -> HullFit | None:
    """The fit where the silhouettes bear it out."""
    return None if fit is None or fit.overlap < fitter.settings.found_overlap else fit


def _fits_of(seen: Sequence[_Frame]) -> list[HullFit]:
    """The hands that were found."""
    return [frame.fit for frame in seen if frame.fit is not None]


def _required_score(fits: Sequence[HullFit]) -> float:
    """The score from which on a frame needs no search."""
    return max(fit.score for fit in fits) - _MAX_DROP_WITHOUT_SEARCH


def _for_shape(seen: Sequence[_Frame]) -> list[_Frame]:
    """The frames to which proportions may be fitted."""
    return _within(seen, _MAX_DROP_FOR_SHAPE)


def _within(seen: Sequence[_Frame], max_drop: float) -> list[_Frame]:
    """The frames whose score is at most so much below the best one."""
    best = max(frame.fit.score for frame in seen if frame.fit is not None)
    return [frame for frame in seen if frame.fit is not None and frame.fit.score >= best - max_drop]


def _scaled_shapes(fitter: FrameFitter) -> list[Tensor]:
    """The generic hand in several sizes."""
    space = fitter.hand.kinematics.shape_space
    metric = torch.tensor([unit == "m" for unit in space.units])
    default = space.default.to(torch.float64)
    scaled = [torch.where(metric, size * default, default) for size in fitter.settings.sizes]
    return [shape.clamp(space.lower.to(shape), space.upper.to(shape)) for shape in scaled]


def _shape_fit(
    fitter: FrameFitter,
    seen: Sequence[_Frame],
    population: Anthropometry,
    shape: Tensor | None = None,
    *,
    is_rough: bool = False,
) -> SharedSolution:
    """is_rough: with half the rounds, where more will follow."""
    settings = fitter.settings.shape
    if is_rough:
        settings = replace(settings, rounds=max(1, settings.rounds // 2))
    found: list[tuple[HullTarget, HullFit]] = [
        (frame.hull.target, frame.fit) for frame in seen if frame.hull.target is not None and frame.fit is not None
    ]
    starts = HandPose.stack([fit.pose for _, fit in found])
    return fit_shape(fitter.shape_fitter(shape), [target for target, _ in found], starts, population, settings)
