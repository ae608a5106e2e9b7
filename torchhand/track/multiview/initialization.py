"""The start on a recording: skin colours of every view, the rig's unit where it is unknown, poses and proportions."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from jaxtyping import Float
from torch import Tensor

from torchhand.hand import Anthropometry, Hand
from torchhand.track.multiview.fitting import FrameFitter
from torchhand.track.multiview.hand_initialization import HandInitialization, initialize_hand
from torchhand.track.multiview.scale import in_unit, resized_pose, resized_shape, rough_units, size_factor
from torchhand.track.multiview.settings import RigSettings
from torchhand.track.scene import Images, LearnedSkin, Masks, ViewSilhouettes

Frame = tuple[int, Images, Masks | None]
"""A frame's index, the pictures of all views, and the silhouettes where they are given."""


@dataclass(frozen=True, kw_only=True)
class Initialization:
    """What some frames of a recording tell before a hand is followed through it."""

    hand: HandInitialization
    """Proportions of the hand, and its poses in the frames in which it was found."""
    skins: Sequence[LearnedSkin | None]
    """Skin colours of every view; None where they are not known."""
    metres: float | None = None
    """Metres of one unit of the rig, where it was to be fitted and a hand was found."""


def initialize(
    hand: Hand,
    silhouettes: ViewSilhouettes,
    frames: Sequence[Frame],
    population: Anthropometry,
    settings: RigSettings,
    *,
    shape: Float[Tensor, "shape"] | None = None,
    fits_unit: bool = False,
    done: Callable[[], object] = lambda: None,
) -> Initialization:
    """Learn colours, unit, proportions and poses from some frames of a recording.

    shape: known proportions. fits_unit: the unit of the cameras' translations is not known and is chosen so that the
    hand is as large as `shape` or, without it, as the average. done: called after every frame.
    """
    skins: list[LearnedSkin | None] = [None] * len(silhouettes.cameras)
    for _, images, given in frames:
        if given is None:
            skins = silhouettes.learn(images, skins)
    seen = [
        (index, silhouettes(images, skins) if given is None else silhouettes.undistorted(given))
        for index, images, given in frames
    ]
    if fits_unit:
        return _with_unit(hand, silhouettes, seen, population, settings, shape, skins, done)
    fitter = FrameFitter(hand, silhouettes.cameras, settings)
    if settings.shape_frames == 0 and shape is None:
        shape = hand.kinematics.default_shape
    return Initialization(hand=initialize_hand(fitter, seen, population, shape=shape, done=done), skins=skins)


def _with_unit(
    hand: Hand,
    silhouettes: ViewSilhouettes,
    seen: Sequence[tuple[int, Masks]],
    population: Anthropometry,
    settings: RigSettings,
    shape: Tensor | None,
    skins: Sequence[LearnedSkin | None],
    done: Callable[[], object],
) -> Initialization:
    """Initialization with the unit that makes the hand as large as it is known, or expected, to be."""
    space = hand.kinematics.shape_space
    units, decisive = rough_units(silhouettes.cameras, seen)
    fitters = {unit: FrameFitter(hand, in_unit(silhouettes.cameras, unit), settings) for unit in units}
    if not fitters:
        nothing = HandInitialization(shape=hand.kinematics.default_shape, shape_std=None, poses={}, shape_frames=())
        return Initialization(hand=nothing, skins=skins)
    nominal = max(fitters, key=lambda unit: max(_agreement(fitters[unit], masks) for _, masks in decisive))
    found = initialize_hand(fitters[nominal], seen, population, done=done)
    if not found.poses:
        return Initialization(hand=found, skins=skins)
    known = space.default.to(found.shape) if shape is None else shape
    factor = size_factor(found.shape, known, space)
    poses = {index: resized_pose(pose, factor) for index, pose in found.poses.items()}
    own = resized_shape(found.shape, factor, space) if shape is None else shape
    return Initialization(hand=replace(found, shape=own, poses=poses), skins=skins, metres=factor * nominal)


def _agreement(fitter: FrameFitter, masks: Masks) -> float:
    """How well a generic hand explains the silhouettes of a frame, 0 to 1: the overlap times the fraction of their
    edges that it explains."""
    found = fitter.search(fitter.hull_anywhere(None, masks), fitter.hand.kinematics.default_shape, masks)
    return 0.0 if found is None else found.overlap * found.covered_fraction
