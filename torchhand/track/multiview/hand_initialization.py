"""The hand before it is followed: its pose in some frames of a recording, and its proportions over all of them."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.cluster import side_by_side
from torchhand.fit import SharedSolution
from torchhand.hand import HandPose
from torchhand.track.multiview.continuity import viterbi_path
from torchhand.track.multiview.fitting import FrameFitter, HullFit, best_of
from torchhand.track.multiview.hulls import Hull
from torchhand.track.scene import Masks, Scene

_EXPLAINED = 0.80
"""Score from which on nothing else is looked for: proposed hands that reached it lay within 20 mm of the truth in the
mean over the joints, in every frame of the synthetic sequences of four cameras."""
_MAX_DROP_FOR_SHAPE = 0.08  # score below the best frame's with which a frame enters the fit of the proportions
_MAX_DROP_AS_FOUND = 0.15  # score below the best frame's with which a hand still counts as found
SHAPE_AT = (1, 3, 6)
"""Hands that were found, with which the proportions are fitted before the last time."""
FOUND_OVERLAP = 0.70
"""Smallest overlap, mean over the views, with which a hand is taken as found."""
_SCORE_PER_NAT = 1e-3  # score that a nat of a fit's cost is worth between fits that explain a frame alike
_FACING_VIEWS = 3  # views that tell by themselves how a hand faces
_AT_ONCE = 2  # frames that are searched at a time after the first hand; more would know less of one another
_MAX_POSES = 8  # poses of other frames that are tried as starts
_MAX_OTHERS = 5  # of these, best first, where all frames decide together how the hand faces


Proposer = Callable[[Scene, Tensor], HandPose | None]
"""Hands (n,) that a scene is read to show, for some proportions; None where it shows none."""


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
    scores: Mapping[int, float] = field(default_factory=dict)
    """How well these hands explain their frames (`HullFit.score`)."""


@dataclass(frozen=True, kw_only=True)
class _Frame:
    """A frame, and the hand in it where it was found."""

    index: int
    masks: Masks
    hull: Hull
    fit: HullFit | None = None
    is_told: bool = False
    """Whether that is the hand of detected keypoints, which tell how it faces."""


def evenly_spaced_frames(count: int, wanted: int) -> tuple[int, ...]:
    """Indices of at most `wanted` frames of `count`, evenly over them."""
    if wanted <= 0 or count <= 0:
        return ()
    size = min(wanted, count)
    return tuple(sorted({round((i + 0.5) * count / size - 0.5) for i in range(size)}))


def initialize_hand(
    fitter: FrameFitter,
    frames: Iterable[tuple[int, Scene]],
    propose: Proposer,
    *,
    detect: Proposer = lambda scene, shape: None,
    shape: Float[Tensor, "shape"] | None = None,
    done: Callable[[bool], object] = lambda is_found: None,
) -> HandInitialization:
    """Find the hand in the frames, a few at a time, and fit its proportions to those in which it was found well.

    Each frame is searched from what is proposed for it and from the hands of frames before. The proportions are fitted
    ever more finely as hands accumulate, all of them with their poses as one problem: the next frames are searched with
    what the ones before have told. Where the views do not tell palm from back, proportions wait until all frames have
    decided that together: those of a hand held the wrong way round would make all others alike.

    detect: hands that are known so well that nothing else is proposed where they explain enough. shape: known
    proportions, which are then only used. done: called after every frame, told whether the hand was found, before
    proportions are fitted to it.

    Without any frame in which a hand is found the proportions are the generic hand's, or those given.
    """
    own = _generic_shape(fitter) if shape is None else shape
    is_told = len(fitter.cameras) >= _FACING_VIEWS
    seen: list[_Frame] = []
    solution: SharedSolution | None = None
    left = iter(frames)
    while group := list(islice(left, _together(len(_fits_of(seen)), is_told=is_told))):
        found = side_by_side(
            [partial(_searched, fitter, frame, own, (propose, detect), _fits_of(seen), shape) for frame in group],
            fitter.hand.shape.device,
        )
        for frame in found:
            seen.append(frame)
            done(frame.fit is not None)
        if shape is None and is_told and _fits_of(found) and len(_fits_of(seen)) in SHAPE_AT:
            seen, solution = _with_shape(fitter, seen, own, is_rough=True)
            own = solution.shape
    if not _fits_of(seen):
        return HandInitialization(shape=own, shape_std=None, poses={}, shape_frames=())
    if not is_told:
        seen = _consistent(fitter, seen, own)
    used: tuple[int, ...] = ()
    if shape is None:
        used = tuple(frame.index for frame in _for_shape(seen))
        seen, solution = _with_shape(fitter, seen, own)
    fits = {frame.index: frame.fit for frame in _within(seen, _MAX_DROP_AS_FOUND) if frame.fit is not None}
    return HandInitialization(
        shape=own if solution is None else solution.shape,
        shape_std=None if solution is None else solution.shape_std,
        poses={index: fit.pose for index, fit in fits.items()},
        shape_frames=used,
        scores={index: fit.score for index, fit in fits.items()},
    )


def _together(found: int, *, is_told: bool) -> int:
    """Number of frames that are searched at a time where so many hands are found: one for the first hand, then no more
    than are missing for the next fit of the proportions. Two views alone tell a hand hardly without those before."""
    if not is_told:
        return 1
    return next((min(_AT_ONCE, wanted - found) for wanted in SHAPE_AT if wanted > found), _AT_ONCE)


def _searched(
    fitter: FrameFitter,
    frame: tuple[int, Scene],
    own: Tensor,
    proposers: tuple[Proposer, Proposer],
    fits: Sequence[HullFit],
    shape: Tensor | None,
) -> _Frame:
    """A frame with the hand in it, where one is found.

    own: proportions so far. proposers: what proposes hands, and what detects them. fits: of other frames. shape: known
    proportions.
    """
    (index, scene), (propose, detect) = frame, proposers
    empty = _Frame(index=index, masks=scene.masks, hull=fitter.hull_anywhere(shape, scene.masks))
    told = _told(fitter, empty, own, detect(scene, own))
    fit = told or _found(fitter, empty, own, propose(scene, own), fits)
    return empty if fit is None else replace(empty, fit=fit, is_told=told is not None)


def _told(fitter: FrameFitter, frame: _Frame, shape: Tensor, detected: HandPose | None) -> HullFit | None:
    """The hand that detected keypoints tell of, where it explains so much that nothing else is looked for."""
    found = fitter.fit_proposed(frame.hull, detected, shape, frame.masks, tries_fingers=False)
    return None if found is None or found.score < _EXPLAINED else _accepted(fitter, found)


def _found(
    fitter: FrameFitter, frame: _Frame, shape: Tensor, proposals: HandPose | None, fits: Sequence[HullFit]
) -> HullFit | None:
    """The hand from what is proposed and from the poses of other frames; searched without a guess too where these leave
    much unexplained. Where the views do not tell palm from back, which the network then guesses, both are tried, of a
    search's hand too."""
    others = [fit.pose for fit in fits[-_MAX_POSES:]]
    hands = [*([] if proposals is None else [proposals]), *([HandPose.stack(others)] if others else [])]
    found = fitter.fit_proposed(frame.hull, HandPose.cat(hands) if hands else None, shape, frame.masks)
    if len(fitter.cameras) >= _FACING_VIEWS:
        if found is None or found.score < _EXPLAINED:
            found = best_of([found, fitter.search(frame.hull, shape, frame.masks)])
        return _accepted(fitter, found)
    found = _on_both_sides(fitter, frame, shape, found)
    if found is None or found.score < _EXPLAINED:
        searched = fitter.search(frame.hull, shape, frame.masks)
        found = best_of([found, _on_both_sides(fitter, frame, shape, searched)])
    return _accepted(fitter, found)


def _on_both_sides(fitter: FrameFitter, frame: _Frame, shape: Tensor, found: HullFit | None) -> HullFit | None:
    """The better of a hand and of one that shows its back where that shows its palm."""
    if found is None:
        return None
    return best_of([found, fitter.turn_over(frame.hull, found.pose, shape, frame.masks)])


def _consistent(fitter: FrameFitter, seen: Sequence[_Frame], shape: Tensor) -> list[_Frame]:
    """Every frame explained so that the hand faces alike in those that follow each other, where both ways will do."""
    found = [(place, frame, frame.fit) for place, frame in enumerate(seen) if frame.fit is not None]
    alternatives = []
    for _, frame, fit in found:
        others = [other for _, _, other in found if other is not fit]
        others = [other.pose for other in sorted(others, key=lambda one: -one.score)[:_MAX_OTHERS]]
        own = [] if frame.is_told else fitter.fit_in_place(frame.hull, fit.pose, others, shape, frame.masks)
        alternatives.append([fit, *own])
    scores = [shape.new_tensor([fit.score - _SCORE_PER_NAT * float(fit.cost) for fit in own]) for own in alternatives]
    facing = [torch.stack([fit.pose.reference for fit in own]) for own in alternatives]
    chosen = list(seen)
    for (place, frame, _), own, index in zip(found, alternatives, viterbi_path(scores, facing), strict=True):
        chosen[place] = replace(frame, fit=own[index])
    return chosen


def _with_shape(
    fitter: FrameFitter, seen: Sequence[_Frame], shape: Tensor, *, is_rough: bool = False
) -> tuple[list[_Frame], SharedSolution]:
    """The frames with the hands that go with proportions fitted to all good ones of them.

    is_rough: with half the rounds, where more will follow.
    """
    good = _for_shape(seen)
    starts = HandPose.stack([fit.pose for fit in _fits_of(good)])
    solution = fitter.fit_shape([frame.hull for frame in good], starts, shape, is_rough=is_rough)
    refitted = {}
    for row, frame in enumerate(good):
        assert frame.fit is not None
        overlaps = fitter.overlaps(solution.pose[row], solution.shape, frame.masks)
        refitted[frame.index] = replace(frame, fit=frame.fit.refitted(solution, row, overlaps))
    return [refitted.get(frame.index, frame) for frame in seen], solution


def _accepted(fitter: FrameFitter, fit: HullFit | None) -> HullFit | None:
    """The fit where the silhouettes bear it out."""
    return None if fit is None or fit.overlap < FOUND_OVERLAP else fit


def _fits_of(seen: Sequence[_Frame]) -> list[HullFit]:
    """The hands that were found."""
    return [frame.fit for frame in seen if frame.fit is not None]


def _for_shape(seen: Sequence[_Frame]) -> list[_Frame]:
    """The frames to which proportions may be fitted."""
    return _within(seen, _MAX_DROP_FOR_SHAPE)


def _within(seen: Sequence[_Frame], max_drop: float) -> list[_Frame]:
    """The frames whose score is at most so much below the best one."""
    best = max(frame.fit.score for frame in seen if frame.fit is not None)
    return [frame for frame in seen if frame.fit is not None and frame.fit.score >= best - max_drop]


def _generic_shape(fitter: FrameFitter) -> Tensor:
    space = fitter.hand.kinematics.shape_space
    default = space.default.to(torch.float64)
    return default.clamp(space.lower.to(default), space.upper.to(default))
