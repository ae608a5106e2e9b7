"""The first look at a recording: colours of every view, unit of the rig where it is unknown, the hand's proportions."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from jaxtyping import Float
from torch import Tensor

from torchhand.hand import Anthropometry, Hand
from torchhand.track.multiview.acquaintance import Acquaintance, acquaint
from torchhand.track.multiview.fitting import Anchor, MomentFitter
from torchhand.track.multiview.scale import in_unit, moved_anchor, resized_shape, rough_units, size_factor
from torchhand.track.multiview.settings import RigSettings
from torchhand.track.scene import Images, LearnedSkin, Masks, ViewSilhouettes

Moment = tuple[int, Images, Masks | None]
"""Its number, the pictures of all views, and the silhouettes where they are given."""


@dataclass(frozen=True, kw_only=True)
class Introduction(Acquaintance):
    """What the first look tells."""

    skins: Sequence[LearnedSkin | None]
    """Of every view; None where none is known."""
    metres: float | None = None
    """Of one unit of the rig, where it was to be fitted and a hand was found."""


def introduce(
    hand: Hand,
    silhouettes: ViewSilhouettes,
    moments: Sequence[Moment],
    people: Anthropometry,
    settings: RigSettings,
    *,
    shape: Float[Tensor, "shape"] | None = None,
    fits_unit: bool = False,
    done: Callable[[], object] = lambda: None,
) -> Introduction:
    """Look at some moments of a recording.

    shape: known proportions. fits_unit: the unit of the cameras' translations is not known and is chosen so that the
    hand is as large as `shape` or, without it, as the average. done: called after every moment.
    """
    skins: list[LearnedSkin | None] = [None] * len(silhouettes.cameras)
    for _, images, given in moments:
        if given is None:
            skins = silhouettes.learn(images, skins)
    seen = [
        (moment, silhouettes(images, skins) if given is None else silhouettes.undistorted(given))
        for moment, images, given in moments
    ]
    if fits_unit:
        return _with_unit(hand, silhouettes, seen, people, settings, shape, skins, done)
    fits = MomentFitter(hand, silhouettes.cameras, settings)
    return _introduction(_met(fits, seen, people, settings, shape, done), skins)


def _met(
    fits: MomentFitter,
    seen: Sequence[tuple[int, Masks]],
    people: Anthropometry,
    settings: RigSettings,
    shape: Tensor | None,
    done: Callable[[], object],
) -> Acquaintance:
    if settings.shape_frames == 0 and shape is None:
        shape = fits.hand.kinematics.default_shape
    return acquaint(fits, seen, people, shape=shape, done=done)


def _with_unit(
    hand: Hand,
    silhouettes: ViewSilhouettes,
    seen: Sequence[tuple[int, Masks]],
    people: Anthropometry,
    settings: RigSettings,
    shape: Tensor | None,
    skins: Sequence[LearnedSkin | None],
    done: Callable[[], object],
) -> Introduction:
    """The same with a unit that makes the hand as large as it is known, or thought, to be."""
    space = hand.kinematics.shape_space
    units, telling = rough_units(silhouettes.cameras, seen)
    fits = {unit: MomentFitter(hand, in_unit(silhouettes.cameras, unit), settings) for unit in units}
    if not fits:
        nothing = Acquaintance(shape=hand.kinematics.default_shape, shape_std=None, anchors={}, learned_from=())
        return _introduction(nothing, skins)
    nominal = max(fits, key=lambda unit: max(_agreement(fits[unit], masks) for _, masks in telling))
    met = acquaint(fits[nominal], seen, people, done=done)
    if not met.anchors:
        return _introduction(met, skins)
    known = space.default.to(met.shape) if shape is None else shape
    factor = size_factor(met.shape, known, space)
    anchors: dict[int, Anchor] = {moment: moved_anchor(anchor, factor) for moment, anchor in met.anchors.items()}
    own = resized_shape(met.shape, factor, space) if shape is None else shape
    return _introduction(replace(met, shape=own, anchors=anchors), skins, metres=factor * nominal)


def _agreement(fits: MomentFitter, masks: Masks) -> float:
    """How well a generic hand explains the silhouettes of a moment, 0 to 1: the overlap times the share of their edges
    that it explains."""
    found = fits.searched(fits.hull_anywhere(None, masks), fits.hand.kinematics.default_shape, masks)
    return 0.0 if found is None else found.overlap * found.fit.covered_share


def _introduction(
    met: Acquaintance, skins: Sequence[LearnedSkin | None], *, metres: float | None = None
) -> Introduction:
    return Introduction(
        shape=met.shape,
        shape_std=met.shape_std,
        anchors=met.anchors,
        learned_from=met.learned_from,
        skins=skins,
        metres=metres,
    )
