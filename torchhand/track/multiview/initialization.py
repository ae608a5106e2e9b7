"""The start on a recording: skin colours of every view, the rig's unit where it is unknown, poses and proportions."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, islice

from jaxtyping import Float
from torch import Tensor

from torchhand.cluster import side_by_side
from torchhand.devices import sent_to
from torchhand.geometry import Camera, Rig
from torchhand.hand import Hand
from torchhand.numerics import single_threaded
from torchhand.track.multiview.fitting import FrameFitter, best_of
from torchhand.track.multiview.hand_initialization import HandInitialization, initialize_hand
from torchhand.track.multiview.proposer import HandProposer
from torchhand.track.multiview.scale import resized_pose, resized_shape, rough_units, size_factor, unit_by_points
from torchhand.track.multiview.settings import RigSettings
from torchhand.track.scene import LearnedSkin, RigSegmentation, Scene, View, ViewSilhouettes, points_of

_SETTLED = 0.1  # agreement that a unit may lack in one frame to be asked about another

Frame = tuple[int, tuple[View, ...]]
"""A frame's index, and its views."""


@dataclass(frozen=True, kw_only=True)
class Initialization:
    """What some frames of a recording tell before a hand is followed through it."""

    hand: HandInitialization
    """Proportions of the hand, and its poses in the frames in which it was found."""
    skins: Sequence[LearnedSkin | None]
    """Skin colours of every view; None where they are not known."""
    metres: float | None = None
    """Metres of one unit of the rig, where it was to be fitted and a hand was found."""


@single_threaded()
def initialize(
    hand: Hand,
    silhouettes: ViewSilhouettes,
    frames: Iterable[Frame],
    settings: RigSettings,
    proposer: HandProposer,
    *,
    shape: Float[Tensor, "shape"] | None = None,
    fits_unit: bool = False,
    done: Callable[[bool], object] = lambda is_found: None,
) -> Initialization:
    """Learn colours, unit, proportions and poses from some frames of a recording.

    frames: read as they are needed where silhouettes are given, so that the first hand does not wait for the last
    frame; keypoints as the cameras without distortion see them. proposer: its cameras do not count. shape: known
    proportions. fits_unit: the unit of the cameras' translations is not known and is chosen so that the hand is as
    large as `shape` or, without it, as the average. done: called after every frame, told whether the hand
    was found.
    """
    skins, frames = _with_skins(silhouettes, frames)
    segmentation = RigSegmentation(silhouettes=silhouettes)
    device = hand.shape.device
    cameras = sent_to(silhouettes.cameras, device)
    seen = (
        (index, segmentation.scene(sent_to(tuple(views), device), tuple(skins), float(index)))
        for index, views in frames
    )
    if fits_unit:
        return _with_unit(hand, cameras, tuple(seen), settings, proposer, shape, skins, done)
    fitter = FrameFitter(hand, cameras, settings)
    if settings.shape_frames == 0 and shape is None:
        shape = hand.kinematics.default_shape
    own = replace(proposer, cameras=fitter.cameras)
    found = initialize_hand(fitter, seen, own, detect=own.detected, shape=shape, done=done)
    return Initialization(hand=found, skins=skins)


def _with_skins(
    silhouettes: ViewSilhouettes, frames: Iterable[Frame]
) -> tuple[list[LearnedSkin | None], Iterable[Frame]]:
    """The skin colours of all frames, and the frames; without reading them where the first has all its silhouettes."""
    skins: list[LearnedSkin | None] = [None] * len(silhouettes.cameras)
    left = iter(frames)
    first = tuple(islice(left, 1))
    if all(view.image is None or view.mask is not None for _, views in first for view in views):
        return skins, chain(first, left)
    every = (*first, *left)
    for _, views in every:
        images = [view.image if view.mask is None else None for view in views]
        skins = silhouettes.learn(images, skins, points_of(views))
    return skins, every


def _with_unit(
    hand: Hand,
    cameras: Sequence[Camera],
    seen: Sequence[tuple[int, Scene]],
    settings: RigSettings,
    proposer: HandProposer,
    shape: Tensor | None,
    skins: Sequence[LearnedSkin | None],
    done: Callable[[bool], object],
) -> Initialization:
    """Initialization with the unit that makes the hand as large as it is known, or expected, to be."""
    space = hand.kinematics.shape_space
    expected = hand.kinematics.default_shape.to(hand.shape) if shape is None else shape
    nominal = unit_by_points(cameras, [scene.views for _, scene in seen], hand.kinematics, expected)
    nominal = _searched_unit(hand, cameras, seen, settings, proposer) if nominal is None else nominal
    if nominal is None:
        nothing = HandInitialization(shape=hand.kinematics.default_shape, shape_std=None, poses={}, shape_frames=())
        return Initialization(hand=nothing, skins=skins)
    fitter = FrameFitter(hand, Rig(cameras).scaled(nominal), settings)
    propose = replace(proposer, cameras=fitter.cameras)
    found = initialize_hand(fitter, seen, propose, detect=propose.detected, done=done)
    if not found.poses:
        return Initialization(hand=found, skins=skins)
    known = space.default.to(found.shape) if shape is None else shape
    factor = size_factor(found.shape, known, space)
    poses = {index: resized_pose(pose, factor) for index, pose in found.poses.items()}
    own = resized_shape(found.shape, factor, space) if shape is None else shape
    return Initialization(hand=replace(found, shape=own, poses=poses), skins=skins, metres=factor * nominal)


def _searched_unit(
    hand: Hand,
    cameras: Sequence[Camera],
    seen: Sequence[tuple[int, Scene]],
    settings: RigSettings,
    proposer: HandProposer,
) -> float | None:
    """The unit in which a search finds the best hand; None where no frame has a hull."""
    units, decisive = rough_units(cameras, [(index, scene.masks) for index, scene in seen])
    if not units:
        return None
    # Sizes differ more than what further fingers and hypotheses tell, which take most of a search's time.
    rough = replace(settings, start=settings.start.reduced())
    fitters = {unit: FrameFitter(hand, Rig(cameras).scaled(unit), rough) for unit in units}
    proposers = {unit: replace(proposer, cameras=fitter.cameras) for unit, fitter in fitters.items()}
    shown = dict(seen)

    def agreements(asked: Sequence[tuple[float, int]]) -> list[float]:
        jobs = [partial(_agreement, fitters[unit], shown[index], proposers[unit]) for unit, index in asked]
        return side_by_side(jobs, hand.shape.device)

    return best_unit(units, [index for index, _ in decisive], agreements)


def best_unit(
    units: Sequence[float],
    frames: Sequence[int],
    agreements: Callable[[Sequence[tuple[float, int]]], Sequence[float]],
) -> float:
    """The unit in which hands explain two frames best: those that one of the middle unit explains best.

    In a frame that hardly shows the hand every unit is a bad guess, and none is the better for having been tried there.
    What is alike in one frame, such as a hand and an elbow of another size, is not in two. agreements: how well a hand
    explains frames in some units, all that is asked for at once.
    """
    middle = units[len(units) // 2]
    told = dict(zip(frames, agreements([(middle, index) for index in frames]), strict=True))
    first, *others = sorted(told, key=told.__getitem__, reverse=True)
    left = [unit for unit in units if unit != middle]
    values = {middle: told[first]}
    values |= dict(zip(left, agreements([(unit, first) for unit in left]), strict=True))
    if others:
        second = others[0]
        near = [unit for unit in units if values[unit] >= max(values.values()) - _SETTLED]
        asked = [unit for unit in near if unit != middle]
        found = dict(zip(asked, agreements([(unit, second) for unit in asked]), strict=True))
        values = {unit: values[unit] + found.get(unit, told[second]) for unit in near}
    return max(values, key=values.__getitem__)


def _agreement(fitter: FrameFitter, scene: Scene, propose: HandProposer) -> float:
    """How well a generic hand explains the silhouettes of a frame, 0 to 1: the overlap times the fraction of their
    edges that it explains."""
    shape = fitter.hand.kinematics.default_shape
    hull = fitter.hull_anywhere(None, scene.masks)
    # Both: what is proposed for a bare arm is as often a hand on the forearm, of another size.
    proposed = fitter.fit_proposed(hull, propose(replace(scene, kept={}), shape), shape, scene.masks)
    found = best_of([proposed, fitter.search(hull, shape, scene.masks)])
    return 0.0 if found is None else found.overlap * found.covered_fraction
