"""The parts of a tracker, put together from a hand, cameras and settings."""

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.devices import sent_to
from torchhand.fit import Schedule
from torchhand.fit.contour import ContourSettings
from torchhand.fit.detect import ContourFitter, StartPoints
from torchhand.fit.keypoints import KeypointSettings
from torchhand.geometry import Camera
from torchhand.hand import FINGERS, Hand, HandKinematics, named_pose_space
from torchhand.image import BackgroundPlate
from torchhand.track.belief import HandMotion
from torchhand.track.extended import ExtendedUpdate, ExtendedUpdateSettings
from torchhand.track.multiview import AccumulatedShape, FrameFitter, HandProposer, HullUpdate
from torchhand.track.proportions import SCHEDULE, FrameFit, OutlineShape, contour_settings
from torchhand.track.proposals import (
    KeypointHand,
    KeypointStart,
    LearnedHands,
    PostureSearch,
    ProposalSource,
    SinglePictureHands,
    TiltedHands,
    hull_sources,
)
from torchhand.track.scene import (
    ColourSegmentation,
    Health,
    RigSegmentation,
    Scene,
    SceneKeypoints,
    Segmentation,
    UpdateRule,
    ViewSilhouettes,
    scene_keypoints,
)
from torchhand.track.settings import TrackerSettings
from torchhand.track.unscented import UnscentedUpdate, UnscentedUpdateSettings
from torchhand.view import OutlineTable, outline_table

_ROOT = 6
_SEARCH_OVERLAP = 0.80  # smallest overlap with which a search of one camera takes a hand as found


@dataclass(frozen=True, kw_only=True)
class Assembly:
    """The parts of one tracker."""

    kinematics: HandKinematics
    """float64"""
    cameras: tuple[Camera, ...]
    """As the scene's silhouettes are seen: without distortion where there are several."""
    motion: HandMotion
    table: OutlineTable
    """Which points of a hand's outline are looked at."""
    segmentation: Segmentation
    rule: UpdateRule
    sources: tuple[ProposalSource, ...]
    """In the order in which they are asked."""
    health: Health
    takes_proposals: bool
    """Whether proposals come as candidates of the tracker's own update rule."""
    keypoint_settings: KeypointSettings
    has_learned_posture: bool = False
    """Whether a network tells the posture of the followed hand."""
    fitter: FrameFitter | None = None
    """What fits hands into hulls, where the update rule does so; None elsewhere."""
    accumulated_shape: AccumulatedShape | OutlineShape | None = None
    """How proportions are fitted while a hand is followed; None where they are known, or those of the first hand."""

    @property
    def tilts(self) -> TiltedHands | None:
        """What tilts the followed hand, where something does."""
        return next((one for one in self.sources if isinstance(one, TiltedHands)), None)

    @property
    def flexes(self) -> bool:
        """Whether the fingers bend, so that frames show them differently."""
        names = self.motion.space.free_names
        return all(f"{finger}_{joint}_fe" in names for finger in FINGERS[1:] for joint in ("mcp", "pip"))

    def frame_fit(self, shape: Float[Tensor, "shape"], schedule: Schedule, contours: ContourSettings) -> FrameFit:
        """The fit of poses to frames of the one camera."""
        return FrameFit(
            kinematics=self.kinematics,
            camera=self.cameras[0],
            motion=self.motion,
            table=self.table,
            keypoints=self.keypoint_settings,
            has_network=self.has_learned_posture,
            shape=shape,
            schedule=schedule,
            contours=contours,
        )

    def with_accumulated_shape(self, settings: TrackerSettings) -> "Assembly":
        """The same with proportions that are fitted while one camera follows a hand, where its frames tell them."""
        if not (settings.shape_frames and self.flexes):
            return self
        contours = contour_settings(settings.update, self.rule.overconfidence)
        outlines = OutlineShape(
            fit=self.frame_fit(self.kinematics.default_shape, SCHEDULE, contours),
            segmentation=self.segmentation,
            health=self.health,
            overconfidence=self.rule.overconfidence,
            count=settings.shape_frames,
        )
        return replace(self, accumulated_shape=outlines)

    def keypoints(self, scene: Scene) -> SceneKeypoints:
        """What detectors found in a scene."""
        return scene_keypoints(scene, self.cameras, self.kinematics, self.keypoint_settings)


def assembled(
    hand: Hand,
    cameras: Sequence[Camera],
    settings: TrackerSettings,
    shape: Float[Tensor, "shape"] | None,
    start_points: StartPoints | None,
    plates: Sequence[BackgroundPlate] | None,
) -> Assembly:
    """Raises ValueError for a silhouette method that lacks its plates, cameras that see no volume together, no cameras,
    and for an update rule in a hull of one camera."""
    if not cameras:
        raise ValueError("cameras: expected at least one, got none")
    is_exact = hand.shape.dtype == torch.float64
    hand = hand if is_exact else copy.deepcopy(hand).double()  # the caller's stays as it is
    motion = HandMotion(
        space=named_pose_space(settings.pose_space).to(device=hand.shape.device),
        skeleton=hand.kinematics.skeleton,
        model=settings.motion,
        noise=settings.noise,
    )
    table = outline_table(settings.points_per_generator, settings.points_per_arc, without=("palm_wrist",))
    table = sent_to(table, hand.shape.device)
    ingredients = _Ingredients(hand=hand, settings=settings, motion=motion, table=table)
    if len(cameras) == 1:
        return _of_one_camera(ingredients, cameras[0], shape, start_points, plates)
    return _of_a_rig(ingredients, cameras, shape, plates)


@dataclass(frozen=True, kw_only=True)
class _Ingredients:
    """What both kinds of tracker are made from."""

    hand: Hand
    settings: TrackerSettings
    motion: HandMotion
    table: OutlineTable

    @property
    def moves_joints(self) -> bool:
        """Whether the pose space has joint angles."""
        return bool(self.motion.space.basis[_ROOT:].any())

    def rule(self, cameras: Sequence[Camera]) -> UpdateRule:
        """An update rule that needs no hull."""
        s = self.settings
        if isinstance(s.update, UnscentedUpdateSettings):
            kinematics = self.hand.kinematics
            return UnscentedUpdate(
                kinematics, cameras, self.motion, self.table, s.update, s.keypoints, side_px=s.check_side_px
            )
        if isinstance(s.update, ExtendedUpdateSettings):
            return ExtendedUpdate(
                self.hand, cameras, self.motion, self.table, s.update, s.keypoints, side_px=s.check_side_px
            )
        raise ValueError(f"method: expected contour or distance for one camera, got {s.method!r}, which needs several")


def _of_one_camera(
    own: _Ingredients,
    camera: Camera,
    shape: Tensor | None,
    start_points: StartPoints | None,
    plates: Sequence[BackgroundPlate] | None,
) -> Assembly:
    """The world is the camera's frame."""
    s, kinematics = own.settings, own.hand.kinematics
    plate = plates[0] if plates else None
    if s.silhouette.method == "background" and plate is None:
        raise ValueError("silhouette.method: 'background' needs a plate of the empty scene")
    here = camera.to(dtype=torch.float64).at_origin()
    fitter = ContourFitter(
        kinematics=kinematics,
        camera=here,
        table=own.table,
        shape=kinematics.default_shape if shape is None else shape,
        fit_shape=shape is None,
        settings=s.fit,
    )
    search = PostureSearch(
        fitter=fitter,
        posture=s.posture,
        silhouette=s.silhouette,
        min_overlap=_SEARCH_OVERLAP,
        plate=plate,
        start_points=start_points,
    )
    sources: tuple[ProposalSource, ...] = (
        KeypointHand(kinematics=kinematics, cameras=(here,), settings=s.keypoints),
        search,
        KeypointStart(fitter=fitter, settings=s.keypoints, min_overlap=s.health.found_overlap),
    )
    if s.learned_proposals and here.kind == "pinhole":
        sources += _by_network(own, fitter, plate, can_start=start_points is None)
    return Assembly(
        kinematics=kinematics,
        cameras=(here,),
        motion=own.motion,
        table=own.table,
        segmentation=ColourSegmentation(kinematics=kinematics, camera=here),
        rule=own.rule((here,)),
        sources=sources,
        health=Health(settings=s.health),
        takes_proposals=False,
        keypoint_settings=s.keypoints,
        has_learned_posture=s.learned_posture and here.kind == "pinhole" and own.moves_joints,
    )


def _by_network(
    own: _Ingredients, fitter: ContourFitter, plate: BackgroundPlate | None, *, can_start: bool
) -> tuple[ProposalSource, ...]:
    """Hands in any posture and, of a hand whose joints are followed by edges along normals, in other tilts.

    Distance maps look as far by themselves: with tilts flexion errors on `rom_palm` and `rom_side` are 5.2° and 4.6°
    there, 4.5° and 4.2° without. can_start: whether the first hand may come from here.
    """
    hands = LearnedHands(
        fitter=fitter,
        silhouette=own.settings.silhouette,
        can_start=can_start,
        can_restart=own.moves_joints,
        plate=plate,
    )
    sources: tuple[ProposalSource, ...] = (hands,)
    if can_start and own.settings.silhouette.method == "skin":
        sources += (SinglePictureHands(fitter=fitter),)
    takes_small_steps = isinstance(own.settings.update, UnscentedUpdateSettings)
    if own.moves_joints and takes_small_steps:
        sources += (TiltedHands(kinematics=fitter.kinematics, camera=fitter.camera),)
    return sources


def _of_a_rig(
    own: _Ingredients, cameras: Sequence[Camera], shape: Tensor | None, plates: Sequence[BackgroundPlate] | None
) -> Assembly:
    """The world is that of the cameras."""
    s, health = own.settings, Health(settings=own.settings.health.for_rig())
    exact = tuple(camera.to(dtype=torch.float64) for camera in cameras)
    silhouettes = ViewSilhouettes(exact, s.silhouette, plates=plates)
    takes_proposals = s.method == "hull"
    rig = replace(s.rig, pose_space=s.pose_space) if takes_proposals else s.rig
    fits = FrameFitter(own.hand, silhouettes.cameras, rig)
    motion = own.motion if takes_proposals else replace(own.motion, space=fits.space)
    hull = HullUpdate(fits, motion, health)
    proposer = HandProposer(
        kinematics=own.hand.kinematics,
        cameras=silhouettes.cameras,
        keypoints=s.keypoints,
        has_network=s.learned_proposals,
    )
    detected = KeypointHand(kinematics=own.hand.kinematics, cameras=silhouettes.cameras, settings=s.keypoints)
    return Assembly(
        kinematics=own.hand.kinematics,
        cameras=silhouettes.cameras,
        motion=own.motion,
        table=own.table,
        segmentation=RigSegmentation(silhouettes=silhouettes),
        rule=hull if takes_proposals else own.rule(silhouettes.cameras),
        sources=(detected, *hull_sources(hull, health, proposer)),
        health=health,
        takes_proposals=takes_proposals,
        keypoint_settings=s.keypoints,
        fitter=fits if takes_proposals else None,
        accumulated_shape=AccumulatedShape(fitter=fits) if shape is None and rig.shape_frames else None,
    )
