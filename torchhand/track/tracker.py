"""The tracker: predict, update, judge; propose other hands where that fails. One camera or several, any update rule.

A tracker is a value: `step` takes a state and the views of one time and returns the next state and the estimate.
"""

import copy
import math
from collections.abc import Callable, Collection, Hashable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.devices import HOST, sent_to
from torchhand.errors import require_kind
from torchhand.files import FrameStatus
from torchhand.fit.contour import hand_length_px
from torchhand.fit.detect import StartPoints
from torchhand.geometry import Camera
from torchhand.hand import Hand, HandPose, scale_covariance
from torchhand.image import BackgroundPlate
from torchhand.numerics import single_threaded
from torchhand.precision import without_autocast
from torchhand.propose import LearnedPosture
from torchhand.track.assembly import Assembly, assembled
from torchhand.track.belief import FollowedHand, posed_belief, unknown_scale_std
from torchhand.track.knowledge import REFIT_EVERY, Estimate, Keyframe, TrackerState
from torchhand.track.multiview import EXPECTED_HULL, Hull, expected_hull
from torchhand.track.proposals import OCCASIONS, Occasion, Proposals, ProposalSource, Proposed
from torchhand.track.quality import FingerEvidence, Told, qualities
from torchhand.track.scene import (
    Appearances,
    Candidate,
    Masks,
    ObservationsOf,
    PlacedHand,
    Scene,
    SceneKeypoints,
    View,
    WorkingViews,
    credible_posture,
    is_same_view,
    learned_observations,
    seen_posture,
)
from torchhand.track.settings import TrackerSettings

_BEST_KEPT = 0.99  # share of the best score that outlasts a frame
_DECLINE = 0.03  # score less than at best, from which on a followed hand is fitted once more with larger steps
_SURE_EDGES = 0.85  # share of the edges that a whole hand explains at least
_TOLD = 0.01  # score that a hand may have less which the network bears out
_VAIN_REFIT_EVERY = 40  # the same where they keep bringing nothing better
_SOON = 3  # frames from one look for misplaced digits to the next, and from such a fit to the first
_FASTEST_M_PER_S, _JUMP_M = 5.0, 0.2
"""How fast a hand moves at most, and how far off its place before a camera may be besides: what is found elsewhere once
the hand is lost is another thing."""
_NOMINAL_DT_S = 1 / 30  # time step that is assumed at the first frame
_UNDETECTED_S = 0.5  # since a hand was detected, for which it is cut out where it is expected
_FORESEEABLE_S = 0.1
"""Time over which a hand's motion foretells where it is. After longer ones the motion model is so unsure that edges
near its contour tell little: from 0.2 s on `contour_planar` loses even a hand that keeps still."""

_SMALL_PX, _MADE_PX = 110.0, 165.0
"""A hand shorter than the first in the picture of one camera is followed in a picture in which it is as long as the
second. On a real recording in which hands are 80 px long as many fingers are off then as where they are 330."""
_MOST_ENLARGED, _SCALE_STEP = 3.0, 0.25

_BESIDE_DETECTORS = ("detected", "declining")
_SILENCE = "the detector finds no hand; without --keypoints one is looked for by its colours"


@dataclass(frozen=True, kw_only=True)
class _Search:
    """The best hand of a scene, and how it was come by."""

    best: Candidate | None
    proposed: Proposed | None
    """The proposal that the best hand came from; None where it was followed."""
    has_foreground: bool
    reason: str
    is_doubted: bool = False
    """Whether other hands were to be looked for, and were not."""
    is_firm: bool = False
    """Whether the side that a followed hand shows is known from its outline (`Health.better`)."""


@dataclass(frozen=True, kw_only=True)
class _Prediction:
    """What is expected at a time."""

    before: FollowedHand | None
    """The hand at the time before, from which it is predicted."""
    shape: Float[Tensor, "shape"] | None
    time_s: float
    hand: FollowedHand | None
    place: Float[Tensor, "3"] | None
    """Place about which a hull of the hand is carved; None where no hull is used."""


@dataclass(frozen=True, kw_only=True)
class Foreseen:
    """What is known of a time before the hand of the time before it is found."""

    appearance: Appearances
    """Appearance of the hand, view by view."""
    masks: Masks
    """Silhouettes of all views."""
    hull: Hull | None = None
    """The hull about where the hand was expected; None where none was carved."""
    views: tuple[View, ...] = ()
    """The views as the tracker works on them, where the same process has made that."""

    def scene(self, views: Sequence[View], time_s: float, expected: Float[Tensor, "3"] | None) -> Scene:
        """The scene of these views, as the cameras that are used see them."""
        kept: dict[Hashable, Any] = {} if self.hull is None else {EXPECTED_HULL: self.hull}
        return Scene(
            views=tuple(views),
            masks=tuple(self.masks),
            probabilities=(None,) * len(views),
            time_s=time_s,
            expected=expected,
            kept=kept,
        )


@dataclass(frozen=True, kw_only=True)
class FollowedInto:
    """A hand that was followed into another scene."""

    candidate: Candidate
    scene: Scene
    estimate: Estimate
    """Estimate without the evidence of its fingers, which takes as long as all the rest of it (`Tracker.told`)."""
    tip_std: Float[Tensor, "5"]
    """Standard deviation of every fingertip about the wrist, metres."""

    @property
    def hand(self) -> FollowedHand:
        return self.candidate.hand


class Tracker:
    """Follows one hand of a known side. Poses are in the world of the cameras, which is the camera's frame of one
    camera.

    Computes in float64 on the hand's device, on the calling thread alone (`single_threaded`): several trackers may run
    in several threads. On a processor the same views give the same numbers bit for bit. Views may be anywhere and are
    sent to the device once; estimates come back to the processor, states stay on the device.
    """

    def __init__(
        self,
        hand: Hand,
        cameras: Camera | Sequence[Camera],
        settings: TrackerSettings | None = None,
        *,
        shape: Float[Tensor, "shape"] | None = None,
        start_points: StartPoints | None = None,
        plates: Sequence[BackgroundPlate] | None = None,
        observations: ObservationsOf | None = None,
        accumulates_shape: bool = True,
    ) -> None:
        """hand: the model; its own shape does not count. shape: proportions where they are known; else they are fitted.

        start_points: where the hand is in the first picture of one camera, in place of a search. plates: the empty
        scene in every view, for the silhouette method "background". observations: what else is known of the hand, scene
        by scene, poses in the tracker's world; any `torchhand.fit.Observation`, under every update rule.
        accumulates_shape: whether proportions are fitted to more and more frames of one camera while the hand is
        followed, as to those of several (`settings.shape_frames`); a step in which they are takes some seconds.
        Raises ValueError where that method lacks its plates, for cameras that see no volume together, and for a shape
        outside its bounds; TypeError for what is no hand, no camera, no settings and no tensor.
        """
        given = (cameras,) if isinstance(cameras, Camera) else tuple(cameras)
        settings = TrackerSettings() if settings is None else settings
        require_kind("hand", hand, Hand)
        require_kind("settings", settings, TrackerSettings)
        for camera in given:
            require_kind("cameras", camera, Camera)
        if shape is not None:
            hand.shape_space.check_one(shape)
        self.settings, self.device = settings, hand.shape.device
        self.cameras = tuple(camera.to(device=self.device) for camera in given)
        known = None if shape is None else shape.double().to(self.device)
        self.known_shape = known
        self._hand, self._start_points, self._plates, self._observations = hand, start_points, plates, observations
        self._fits_shape = accumulates_shape and known is None and len(self.cameras) == 1
        self._of_scale: dict[float, Tracker] = {}
        """The same tracker on pictures of other sizes."""
        self._work_on(1.0)
        self.kinematics = self.parts.kinematics
        self._scale_std = 0.0
        if len(self.cameras) == 1:
            space = self.kinematics.shape_space
            self._scale_std = unknown_scale_std(space, self.cameras[0], is_shape_known=known is not None)

    def _work_on(self, scale: float) -> None:
        """Be the tracker on pictures whose sides are so many times as long."""
        self._of_scale[scale] = self
        self._working = working = WorkingViews(self.cameras, self.settings.max_pixels, scale=scale)
        plates, start_points = working.plates(self._plates), working.points(self._start_points)
        parts = assembled(self._hand, working.cameras, self.settings, self.known_shape, start_points, plates)
        self.parts: Assembly = parts.with_accumulated_shape(self.settings) if self._fits_shape else parts
        self._evidence = FingerEvidence(self.parts.kinematics, self.parts.cameras)
        self._last: tuple[Appearances, Scene] | None = None
        self._last_prediction: _Prediction | None = None

    def at(self, state: TrackerState) -> "Tracker":
        """The tracker on pictures of the size that a state's hand is followed in. Scenes, and what is done in them, are
        of one size; `step`, `scene` and `reshaped` find it by themselves."""
        if state.picture_scale not in self._of_scale:
            other = copy.copy(self)
            other._work_on(state.picture_scale)
        return self._of_scale[state.picture_scale]

    # ------------------------------------------------------------------ a frame

    @without_autocast
    @torch.inference_mode()
    @single_threaded()
    def step(
        self,
        state: TrackerState | None,
        views: Sequence[View],
        time_s: float,
        *,
        occasions: Collection[Occasion] = OCCASIONS,
        other: TrackerState | None = None,
        foreseen: Foreseen | None = None,
        judges: Callable[[Told], bool] | None = None,
    ) -> tuple[TrackerState, Estimate]:
        """The next state and the estimate of this time.

        state: that of the frame before, None at first. views: one per camera; an empty one where its picture is
        missing. time_s: of the frame, after that of the one before. occasions: those of the sources of other hands that
        may be asked; where one of another occasion should be, the estimate tells (`is_doubted`), and where a search may
        not be, proportions are not fitted (`reshaped`). other: what another tracker knew at an
        earlier time, whose hand is compared with this one's as proposed hands are. foreseen: what `foresee` makes of
        these views, where that is known. judges: asked, with what is known of an estimated hand, whether somebody else
        gathers the evidence of its fingers: then the estimate comes without that and without qualities
        (`with_qualities`).

        A hand that the views do not bear out is looked for otherwise at once, one in doubt when a search is due; a hand
        found again after a lost frame is `recovered`. Raises ValueError for views that are not the cameras' in number
        or size, and for a time that does not advance; TypeError for what is no sequence of views.
        """
        state = self._started(state)
        if (own := self.at(state)) is not self:
            return own.step(state, views, time_s, occasions=occasions, other=other, foreseen=foreseen, judges=judges)
        self._check(views, state, time_s)
        prediction, expected_before = self._prediction(state, time_s), state.expected
        predicted = prediction.hand
        state = replace(state, time_s=time_s, expected=prediction.place)
        if all(view.is_empty for view in views):
            return self._unseen(state, predicted)
        views = self._worked_on(views)
        if foreseen is None:
            looks = state.appearance or self.parts.segmentation.initial_appearances(views)
            pose = self._expected_pose(predicted, state, time_s)
            scene = self.parts.segmentation.scene(views, looks, time_s, pose, state.shape)
            scene = replace(scene, expected=expected_before)
        else:
            looks, scene = foreseen.appearance, foreseen.scene(views, time_s, expected_before)
        scene = self._observed(scene)
        self._last = (looks, scene)
        scene = replace(scene, guesses=tuple(one.pose for one in state.keyframes if one.is_of(time_s)))
        state = replace(
            state,
            appearance=looks,
            detected_s=state.detected_s if all(view.keypoints is None for view in views) else time_s,
            frames_since_search=state.frames_since_search + 1,
            frames_since_refit=state.frames_since_refit + 1,
            frames_since_alternatives=state.frames_since_alternatives + 1,
        )
        followed = None
        if state.hand is not None and predicted is not None and state.shape is not None:
            followed = self._followed(state.hand, predicted, scene, state.shape)
        facing = None if predicted is None else predicted.reference
        has_hand, is_firm = followed is not None, state.began_open
        search = _Search(best=followed, proposed=None, has_foreground=has_hand, reason="", is_firm=is_firm)
        search = search if other is None else self._with_other(search, other, facing, scene, state)
        state, search = self._searched(state, search, facing, scene, occasions)
        state, estimate = self._adopted(
            state, search, predicted, scene, fits_shape="search" in occasions, judges=judges
        )
        return state, sent_to(replace(estimate, is_doubted=search.is_doubted), HOST)

    def is_reshape_due(self, state: TrackerState) -> bool:
        """Whether the frames that a state keeps are enough to fit the proportions anew."""
        accumulated = self.parts.accumulated_shape
        return accumulated is not None and accumulated.is_due(state)

    @without_autocast
    @torch.inference_mode()
    @single_threaded()
    def reshaped(self, state: TrackerState) -> TrackerState:
        """The state with proportions that are fitted to the frames it keeps; takes seconds. The same where it keeps
        none."""
        accumulated = self.at(state).parts.accumulated_shape
        return state if accumulated is None else accumulated.fitted(state)

    @torch.inference_mode()
    @single_threaded()
    def follow(self, state: TrackerState, hand: FollowedHand, scene: Scene, dt_s: float) -> FollowedInto | None:
        """A hand in another scene, with nothing else looked for; None where it does not fit there."""
        if state.shape is None:
            return None
        predicted = self.parts.motion.predicted(hand, abs(dt_s))
        return self._into(self.parts.rule.follow(hand, predicted, scene, state.shape), scene, state)

    @torch.inference_mode()
    @single_threaded()
    def begun(self, state: TrackerState, pose: HandPose, scene: Scene) -> FollowedInto | None:
        """A hand in another scene near a pose (), with nothing else looked for; None where it does not fit there."""
        if state.shape is None:
            return None
        pose = pose.to(state.shape).normalized()
        return self._into(self.parts.rule.begin(pose, None, scene, state.shape), scene, state)

    def _into(self, found: Candidate | None, scene: Scene, state: TrackerState) -> FollowedInto | None:
        if found is None or self.parts.health.is_failing(found):
            return None
        estimate, tip_std = self._posed("tracked", found, state, scene)
        return FollowedInto(candidate=found, scene=scene, estimate=sent_to(estimate, HOST), tip_std=tip_std)

    @torch.inference_mode()
    @single_threaded()
    def told(self, state: TrackerState, followed: FollowedInto) -> Estimate:
        """The whole estimate of a hand that was followed into another scene."""
        told = self._told(followed.candidate, state, followed.scene, followed.tip_std)
        return sent_to(self._with_evidence(followed.estimate, told, followed.scene, state), HOST)

    @torch.inference_mode()
    @single_threaded()
    def candidate(self, pose: HandPose, scene: Scene, shape: Float[Tensor, "shape"]) -> Candidate | None:
        """A hand near a pose as the update rule finds it in a scene, whatever is followed; None where it finds none."""
        found = self.parts.rule.begin(pose, None, scene, shape)
        return self._with_agreements(found, scene, shape)

    @torch.inference_mode()
    @single_threaded()
    def placed(self, state: TrackerState, pose: HandPose, scene: Scene) -> tuple[TrackerState, Estimate] | None:
        """The state and the estimate with another hand in the place of the followed one, near a pose () with a zero
        rotation vector, in the scene of the last step; None where the scene does not bear it out."""
        if state.shape is None:
            return None
        seen = self._seen_posture(scene, pose, state.shape)
        told = () if seen is None else learned_observations(seen, pose)
        begun = self.parts.rule.begin(
            pose, None, replace(scene, observations=(*scene.observations, *told)), state.shape
        )
        found = self._with_agreements(begun, scene, state.shape)
        if found is None or not self.parts.health.is_found(found):
            return None
        search = _Search(best=found, proposed=Proposed(pose=pose), has_foreground=True, reason="")
        state, estimate = self._adopted(state, search, None, scene)
        return state, sent_to(replace(estimate, status="tracked"), HOST)

    @torch.inference_mode()
    def at_rest(self, hand: FollowedHand) -> FollowedHand:
        """The same hand with rates of which nothing is known, from where it can be followed into either time."""
        prior = self.parts.motion.prior(hand)
        return replace(hand, belief=self.parts.motion.at_rest(prior.mean, prior.covariance))

    def is_sure(self, estimate: Estimate) -> bool:
        """Whether so much is explained that there is a hand, and no arm or half a hand."""
        edges, overlap = estimate.edges or 0.0, estimate.overlap or 0.0
        return overlap >= self.settings.health.found_overlap and edges >= _SURE_EDGES

    @torch.inference_mode()
    @single_threaded()
    def scene(self, state: TrackerState, views: Sequence[View], time_s: float) -> Scene:
        """What `step` sees in the views of one time; the scene of its last call where views and colours are those."""
        if (tracker := self.at(state)) is not self:
            return tracker.scene(state, views, time_s)
        own = self._worked_on(views)
        if self._last is not None:
            looks, scene = self._last
            if looks is state.appearance and scene.time_s == time_s and all(map(is_same_view, scene.views, own)):
                return scene
        pose = self._expected_pose(state.hand, state, time_s)
        return self._observed(self.parts.segmentation.scene(own, state.appearance, time_s, pose, state.shape))

    def _expected_pose(self, hand: FollowedHand | None, state: TrackerState, time_s: float) -> HandPose | None:
        """Where a hand may be cut out in a picture in which no detector finds it; None where it was detected too long
        ago: such cuts bear out any hand about which they are made."""
        if hand is None or state.detected_s is None or abs(time_s - state.detected_s) > _UNDETECTED_S:
            return None
        return self.parts.motion.pose(hand)

    @torch.inference_mode()
    @single_threaded()
    def expected(self, state: TrackerState, time_s: float) -> Float[Tensor, "3"] | None:
        """Where the hull of the frame after the one at a time will be carved, from what is known before that one; world
        frame, metres. None where no hand is followed, or no hull is used."""
        return self._prediction(state, time_s).place

    @torch.inference_mode()
    @single_threaded()
    def foresee(
        self, appearance: Appearances, views: Sequence[View], time_s: float, expected: Float[Tensor, "3"]
    ) -> Foreseen:
        """What `step` sees in the views of one time, as far as it depends on no other; of several cameras.

        appearance, expected: of the state after the time before (`TrackerState.expected`).
        """
        own, segmentation = self._worked_on(views), self.parts.segmentation
        looks = appearance or segmentation.initial_appearances(own)
        scene = replace(segmentation.scene(own, looks, time_s), expected=expected)
        hull = None if self.parts.fitter is None else expected_hull(self.parts.fitter, scene)
        return Foreseen(appearance=looks, masks=scene.masks, hull=hull, views=scene.views)

    @torch.inference_mode()
    @single_threaded()
    def borne_out(
        self, pose: HandPose, placed: PlacedHand, shape: Float[Tensor, "shape"], foreseen: Foreseen, time_s: float
    ) -> Float[Tensor, "5 4"]:
        """What the views of one time bear out of a hand's fingers: the part of the evidence that takes time, and that
        needs nothing else than what `foresee` of this tracker has made of them."""
        scene = foreseen.scene(foreseen.views, time_s, None)
        return self._evidence.borne_out(pose, placed, shape, scene)

    @torch.inference_mode()
    @single_threaded()
    def with_qualities(self, estimate: Estimate, told: Told, borne_out: Float[Tensor, "5 4"]) -> Estimate:
        """The whole estimate of a step whose evidence somebody else has gathered, once it is known what the views bear
        out of its fingers (`borne_out`)."""
        return sent_to(self._with_qualities(estimate, self._evidence.of(told, borne_out)), HOST)

    def _prediction(self, state: TrackerState, time_s: float) -> _Prediction:
        """What is expected at a time, worked out once."""
        hand, shape, last = state.hand, state.shape, self._last_prediction
        if last is not None and last.before is hand and last.shape is shape and last.time_s == time_s:
            return last
        predicted = place = None
        if hand is not None:
            dt_s = _NOMINAL_DT_S if state.time_s is None else time_s - state.time_s
            predicted = self.parts.motion.predicted(hand, dt_s)
            if self.parts.fitter is not None and shape is not None:
                place = self.parts.fitter.place_of(self.parts.motion.pose(predicted).normalized(), shape)
        found = _Prediction(before=hand, shape=shape, time_s=time_s, hand=predicted, place=place)
        self._last_prediction = found
        return found

    def _observed(self, scene: Scene) -> Scene:
        """The scene with further observations, among which are detected keypoints where the update rule does not look
        for these by itself."""
        further = () if self._observations is None else tuple(self._observations(scene))
        keypoints = self.parts.keypoints(scene).observations if self.parts.takes_proposals else ()
        return replace(scene, observations=(*further, *keypoints))

    def _followed(self, hand: FollowedHand, predicted: FollowedHand, scene: Scene, shape: Tensor) -> Candidate | None:
        """The prediction corrected by the scene (`_corrected`). Where the hand was seen long ago, and the scene does
        not bear that out, also the hand as if it were found where it was: whichever explains the scene better."""
        found = self._corrected(hand, predicted, scene, shape)
        if predicted.dt_s <= _FORESEEABLE_S or not self.parts.health.is_failing(found):
            return found
        motion = self.parts.motion
        begun = replace(hand, belief=motion.at_rest(motion.prior(hand).mean, None))
        resting = motion.predicted(begun, _NOMINAL_DT_S)
        other = self._corrected(hand, replace(resting, dt_s=predicted.dt_s), scene, shape)
        if found is None or other is None:
            return found or other
        return max(found, other, key=self.parts.health.score)

    def _corrected(self, hand: FollowedHand, predicted: FollowedHand, scene: Scene, shape: Tensor) -> Candidate | None:
        """The prediction corrected by the scene, and by what the network sees where the hand is expected. Where fingers
        are bent otherwise, and no detector tells of them, also the prediction with these put there: whichever explains
        the scene, the latter where both do. Where a detector tells of them, and of other fingers than the hand then
        has, also the hand in which the network's view of these does not count."""
        motion, rule = self.parts.motion, self.parts.rule
        pose = motion.pose(predicted).normalized()
        seen = self._seen_posture(scene, pose, shape)
        if seen is None:
            return self._with_agreements(rule.follow(hand, predicted, scene, shape), scene, shape)
        told = replace(scene, observations=(*scene.observations, *learned_observations(seen, pose)))
        found = self._with_agreements(rule.follow(hand, predicted, told, shape), scene, shape, seen)
        keypoints = self.parts.keypoints(scene)
        if keypoints.observations:
            return self._by_detector(hand, predicted, (found, seen, keypoints), scene, shape)
        put, is_put = credible_posture(seen, pose, motion.space.free_names)
        if not bool(is_put.any()):
            return found
        other = rule.follow(hand, motion.put(predicted, put, is_put), told, shape)
        return self._likelier(found, self._with_agreements(other, scene, shape, seen))

    def _by_detector(
        self,
        hand: FollowedHand,
        predicted: FollowedHand,
        by_both: tuple[Candidate | None, LearnedPosture, SceneKeypoints],
        scene: Scene,
        shape: Tensor,
    ) -> Candidate | None:
        """A hand corrected by the network and a detector, or that by the detector where it contradicts the former.

        by_both: that hand, what the network sees, what the detector does.
        """
        found, seen, keypoints = by_both
        if found is None or not bool((without := keypoints.contradicted(found.pose, shape)[1:]).any()):
            return found
        own = learned_observations(seen, self.parts.motion.pose(predicted).normalized(), without=without)
        told = replace(scene, observations=(*scene.observations, *own))
        other = self.parts.rule.follow(hand, predicted, told, shape)
        return self._likelier(found, self._with_agreements(other, scene, shape, seen))

    def _likelier(self, found: Candidate | None, other: Candidate | None) -> Candidate | None:
        """The other hand, unless the first one explains the scene better."""
        if found is None or other is None:
            return found or other
        score = self.parts.health.score
        return other if score(other) > score(found) - _TOLD else found

    def _seen_posture(self, scene: Scene, pose: HandPose, shape: Tensor) -> LearnedPosture | None:
        """What the network sees where a hand is expected."""
        if not self.parts.has_learned_posture:
            return None
        return seen_posture(scene, self.parts.cameras[0], self.kinematics, pose, shape)

    def _segmented(self, scene: Scene, state: TrackerState) -> Scene:
        """The scene with the silhouette by the colours that the first hand has brought only now."""
        if len(self.cameras) > 1 or scene.plane(0) is not None:
            return scene
        return self.parts.segmentation.scene(scene.views, state.appearance, scene.time_s)

    def _started(self, state: TrackerState | None) -> TrackerState:
        if state is not None:
            return state
        return TrackerState(
            shape=self.known_shape,
            search_after=self.parts.health.settings.first_search_after,
            shape_frames=None if self.parts.accumulated_shape is None else (),
        )

    def _check(self, views: Sequence[View], state: TrackerState, time_s: float) -> None:
        require_kind("views", views, Sequence)
        if len(views) != len(self.cameras):
            raise ValueError(f"views: expected one per camera, {len(self.cameras)}, got {len(views)}")
        for index, (view, camera) in enumerate(zip(views, self.cameras, strict=True)):
            require_kind(f"views[{index}]", view, View)
            for name, picture in (("image", view.image), ("mask", view.mask)):
                if picture is not None and picture.shape[:2] != (camera.height, camera.width):
                    got = f"{picture.shape[1]}×{picture.shape[0]} px"
                    expected = f"{camera.width}×{camera.height} px as the camera says"
                    raise ValueError(f"views[{index}].{name}: expected {expected}, got {got}")
        if not math.isfinite(time_s) or (state.time_s is not None and not time_s > state.time_s):
            raise ValueError(f"time_s: expected a finite time after {state.time_s}, got {time_s!r}")

    def _worked_on(self, views: Sequence[View]) -> list[View]:
        """Of bounded size, and with keypoints as cameras without distortion would see them where these are used."""
        return [self._working.of(view, index, self.parts.cameras[index]) for index, view in enumerate(views)]

    def _with_agreements(
        self, found: Candidate | None, scene: Scene, shape: Tensor, seen: LearnedPosture | None = None
    ) -> Candidate | None:
        """A candidate with what detected keypoints say of it, and the network: `seen`, or what it sees there now.

        Of a hand that is followed the latter is a mean over the last frames, for a fist looks much alike from either
        side."""
        if found is None:
            return None
        keypoints = self.parts.keypoints(scene).agreement(found.pose, shape, found.frames)
        seen = self._seen_posture(scene, found.pose.normalized(), shape) if seen is None else seen
        if seen is None:
            return replace(found, keypoints=keypoints)
        direction = float(seen.direction_agreement(found.rotation))
        return replace(found, keypoints=keypoints, direction=direction, learned=seen).remembering(found.hand.direction)

    def _unseen(self, state: TrackerState, predicted: FollowedHand | None) -> tuple[TrackerState, Estimate]:
        """The step over a time of which nothing was seen: after `health.patience` in a row the track is given up."""
        hand = self._failed(predicted)
        return replace(state, hand=hand), self._nothing(state, "no_hand", "no view could be read")

    # ------------------------------------------------------------------ other hands

    def _searched(
        self,
        state: TrackerState,
        search: _Search,
        facing: Tensor | None,
        scene: Scene,
        occasions: Collection[Occasion],
    ) -> tuple[TrackerState, _Search]:
        """The hand so far, or another one where that is in doubt and the other explains enough more.

        facing: world_from_hand as expected. A source is not asked again about a hand that it was asked about already.
        Where none is followed and a detector finds none, none is looked for: something else would be taken for it.
        """
        health = self.parts.health
        is_told = self._start_points is not None and not state.has_started
        if state.hand is None and search.best is None and not is_told and _is_silent(scene):
            return state, replace(search, reason=_SILENCE)
        asked: dict[type, Candidate | None] = {}
        tried = self._tried(search.best, scene, state)
        state, misplaced = self._with_misplaced(search.best, scene, state)
        is_misplaced = misplaced != state.digits_tried
        for source in self.parts.sources:
            kind = type(source)
            is_due = self._is_due(source, search.best, scene, state, is_tried=kind in tried, is_misplaced=is_misplaced)
            if not is_due or (kind in asked and asked[kind] is search.best):
                continue
            if source.occasion not in occasions:
                search = replace(search, is_doubted=True)
                continue
            asked[kind] = search.best
            before = search.best
            proposals = source(scene, state, before)
            search, has_found = self._compared(search, proposals, facing, scene, state)
            if source.occasion == "search":
                has_found &= search.best is not before
                after = health.settings.next_search(state.search_after, has_found=has_found)
                in_vain = 0 if has_found else state.searches_in_vain + 1
                state = replace(state, frames_since_search=0, search_after=after, searches_in_vain=in_vain)
            elif source.occasion == "declining":
                is_vain = search.best is before
                after = min(2 * state.refit_after, _VAIN_REFIT_EVERY) if is_vain else REFIT_EVERY
                state = replace(state, frames_since_refit=0, refit_after=after, digits_tried=misplaced)
        return state if search.is_doubted else self._after_alternatives(state, search, tried), search

    def _with_misplaced(
        self, best: Candidate | None, scene: Scene, state: TrackerState
    ) -> tuple[TrackerState, tuple[bool, ...]]:
        """Digits of one camera's hand that are misplaced, and the state without those tried that no longer are; every
        few frames, in others those that were tried."""
        since, tilts = state.frames_since_refit, self.parts.tilts
        if tilts is None or since == 0 or since % _SOON:
            return state, state.digits_tried
        misplaced = tilts.misplaced(best, scene, state.shape)
        known = state.digits_tried or (False,) * len(misplaced)
        tried = tuple(one and was for one, was in zip(misplaced, known, strict=False))
        return replace(state, digits_tried=tried), misplaced

    def _with_other(
        self, search: _Search, other: TrackerState, facing: Tensor | None, scene: Scene, state: TrackerState
    ) -> _Search:
        """The better of the best hand so far and the one that another tracker followed to an earlier time."""
        if other.hand is None or other.time_s is None or state.shape is None:
            return search
        predicted = self.parts.motion.predicted(other.hand, scene.time_s - other.time_s)
        candidate = self._followed(other.hand, predicted, scene, state.shape)
        if candidate is None:
            return search
        return self._better(search, Proposed(pose=candidate.pose), candidate, facing)

    def _tried(self, followed: Candidate | None, scene: Scene, state: TrackerState) -> frozenset[type]:
        """Kinds of sources that may be asked for other hands in the place of a degraded one.

        All at once where it has only now become so, or is failing, or explains less than when it was last tried; else
        one after the other. The longer they do not help, the fewer frames.
        """
        health, kinds = self.parts.health, self._kinds(followed, scene)
        if not self._is_budgeted:
            return frozenset(kinds)
        if not health.is_degraded(followed, state.usual_score):
            return frozenset()
        since, after = state.frames_since_alternatives, state.alternatives_after
        is_new = state.score_in_vain is None
        if followed is not None and state.score_in_vain is not None:
            is_new = health.score(followed) < state.score_in_vain - health.settings.max_score_drop
        is_failing = health.is_failing(followed)
        if not is_new and not health.settings.alternatives_are_due(since, after, is_failing=is_failing):
            return frozenset()
        if is_new or is_failing:
            return frozenset(kinds)
        return frozenset((kinds[state.alternatives_tried % len(kinds)],))

    @property
    def _is_budgeted(self) -> bool:
        """Whether a degraded hand is found otherwise in some frames alone."""
        return self.parts.health.settings.alternatives_at_most_every > 1

    def _kinds(self, best: Candidate | None, scene: Scene) -> tuple[type, ...]:
        """Kinds of the sources that are asked about a degraded hand, in their order.

        Where detectors see it in two pictures or more, and where it is, other sources hardly know better: asked 64
        times about such hands of a real recording, they told a better one once.
        """
        sources = [one for one in self.parts.sources if one.occasion != "always"]
        is_elsewhere = best is None or best.keypoints is None or self.parts.health.is_detected_elsewhere(best)
        if not is_elsewhere and len(self.parts.keypoints(scene).pictures) > 1:
            sources = [one for one in sources if one.occasion in _BESIDE_DETECTORS]
        return tuple(dict.fromkeys(type(one) for one in sources))

    def _after_alternatives(self, state: TrackerState, search: _Search, tried: frozenset[type]) -> TrackerState:
        health, best, settings = self.parts.health, search.best, self.parts.health.settings
        if not self._is_budgeted:
            return state
        is_healthy = not health.is_degraded(best, state.usual_score)
        if not tried:
            return replace(state, alternatives_after=max(0, state.alternatives_after - is_healthy))
        return replace(
            state,
            frames_since_alternatives=0,
            alternatives_after=settings.next_alternatives(state.alternatives_after, has_helped=is_healthy),
            alternatives_tried=state.alternatives_tried + (len(tried) == 1),
            score_in_vain=None if is_healthy else 0.0 if best is None else health.score(best),
        )

    def _is_due(
        self,
        source: ProposalSource,
        best: Candidate | None,
        scene: Scene,
        state: TrackerState,
        *,
        is_tried: bool,
        is_misplaced: bool,
    ) -> bool:
        """is_tried: whether it may be asked about a degraded hand in this frame. is_misplaced: whether a digit
        lies outside the silhouette, or leaves a part of it out, that was not tried elsewhere."""
        health, occasion = self.parts.health, source.occasion
        is_refit_due = is_misplaced or state.frames_since_refit >= state.refit_after
        if occasion == "always":
            return True
        if type(source) not in self._kinds(best, scene):
            return False
        if not health.is_degraded(best, state.usual_score):
            is_declining = best is not None and health.score(best) < state.best_score - _DECLINE
            is_declining |= is_misplaced
            return occasion == "declining" and is_declining and is_refit_due
        if not is_tried or (occasion == "declining" and not self._is_budgeted and not is_refit_due):
            return False
        if occasion != "search":
            return True
        is_urgent = health.settings.searches_when_failing and health.is_failing(best)
        return is_urgent or state.frames_since_search >= state.search_after

    def _compared(
        self, search: _Search, proposals: Proposals, facing: Tensor | None, scene: Scene, state: TrackerState
    ) -> tuple[_Search, bool]:
        """The better of the best hand so far and the proposed ones, and whether any of these is a hand at all. What is
        refused although nothing in it is degraded is left, or no other source would be asked."""
        has_found, health = False, self.parts.health
        has_foreground = search.has_foreground or proposals.has_foreground
        search = before = replace(search, has_foreground=has_foreground, reason=proposals.reason or search.reason)
        for proposed in proposals.hands:
            candidate = self._alike(self._judged(proposed, scene, state), state.hand, facing)
            if candidate is not None and search.best is None and (away := _out_of_reach(candidate, state, scene)):
                search = replace(search, reason=away)
            elif candidate is not None:
                is_found = health.is_found(candidate)
                better = self._better(search, proposed, candidate, facing)
                is_left = search.best is None and not (is_found or health.is_degraded(candidate, state.usual_score))
                search = replace(search, reason=better.reason) if is_left else better
                has_found |= is_found
        return self._from_known_side(search, before, facing, scene, state), has_found

    def _from_known_side(
        self, search: _Search, before: _Search, facing: Tensor | None, scene: Scene, state: TrackerState
    ) -> _Search:
        """What a search has found, unless it is a hand that is turned over although its side was known, and hands with
        that side explain nearly as much that nobody has proposed. before: the search before."""
        best, first, tilts = search.best, before.best, self.parts.tilts
        if tilts is None or facing is None or best is None or first is None or best is first:
            return search
        is_over = search.is_firm and best.is_turned_from(facing) and not first.is_turned_from(facing)
        if not is_over or best.keypoints is not None or state.shape is None or search.proposed is None:
            return search
        known = before
        for proposed in tilts.turned_back(scene, state.shape, best).hands:
            candidate = self._alike(self._judged(proposed, scene, state), state.hand, facing)
            if candidate is not None and not candidate.is_turned_from(facing):
                known = self._better(known, proposed, candidate, facing)
        return search if known.best is first else self._better(known, search.proposed, best, facing)

    def _alike(
        self, proposed: Candidate | None, followed: FollowedHand | None, facing: Tensor | None
    ) -> Candidate | None:
        """A proposed hand with what the network said before of the followed one's direction, as long as it is not
        turned away from it: that counts for both, or the followed one would live on it."""
        if proposed is None or followed is None or facing is None or proposed.is_turned_from(facing):
            return proposed
        return proposed.remembering(followed.direction)

    def _better(self, search: _Search, proposed: Proposed, candidate: Candidate, facing: Tensor | None) -> _Search:
        """The better of the best hand so far and a proposed one, as the tracker's update rule sees that."""
        health, best = self.parts.health, search.best
        if not health.is_found(candidate):
            told = f"edges on {candidate.edges:.0%}, overlap {candidate.overlap:.2f}"
            search = replace(search, reason=f"no hand where the search began ({told})")
            if best is not None and not health.is_failing(best):
                return search  # what is no hand takes no hand's place
        if health.better(best, candidate, facing, is_firm=search.is_firm) is best:
            return search
        return replace(search, best=candidate, proposed=proposed)

    def _judged(self, proposed: Proposed, scene: Scene, state: TrackerState) -> Candidate | None:
        """A proposal as the tracker's own update rule sees it."""
        shape = state.shape if proposed.shape is None else proposed.shape
        if shape is None:
            return None
        if proposed.candidate is not None and self.parts.takes_proposals:
            return self._with_agreements(proposed.candidate, scene, shape)
        if proposed.appearance is not None:  # the scene has been segmented otherwise
            scene = self._observed(self.parts.segmentation.scene(scene.views, (proposed.appearance,), scene.time_s))
        begun = self.parts.rule.begin(proposed.pose, proposed.covariance, scene, shape)
        return self._with_agreements(begun, scene, shape)

    # ------------------------------------------------------------------ what follows

    def _adopted(
        self,
        state: TrackerState,
        search: _Search,
        predicted: FollowedHand | None,
        scene: Scene,
        *,
        fits_shape: bool = True,
        judges: Callable[[Told], bool] | None = None,
    ) -> tuple[TrackerState, Estimate]:
        health, best, is_new = self.parts.health, search.best, search.proposed is not None
        is_bad = best is None or (not health.is_found(best) if is_new else health.is_failing(best))
        if best is None or is_bad:
            return self._without(state, search, predicted)
        was_lost, is_first = state.has_started and predicted is None, not state.has_started
        state = self._remembered(state, search.proposed, best, scene, is_new=is_new)
        estimate, tip_std = self._posed("recovered" if was_lost else "tracked", best, state, scene)
        told = self._told(best, state, scene, tip_std)
        if judges is None or not judges(told):
            estimate = self._with_evidence(estimate, told, scene, state)
        if self.parts.accumulated_shape is not None:
            state = self.parts.accumulated_shape(state, best, scene, fits=fits_shape)
        return self._sized(state, best.pose) if is_first else state, replace(estimate, is_new=is_new)

    def _sized(self, state: TrackerState, pose: HandPose) -> TrackerState:
        """The state for larger pictures where a hand that was just found at a pose is small in those of one camera;
        what it kept of smaller ones is forgotten."""
        if len(self.cameras) > 1 or not self.parts.flexes or state.shape is None:
            return state
        camera = self.own_cameras[0]
        length_px = hand_length_px(camera, self.kinematics, pose.dofs, state.shape)
        if length_px > _SMALL_PX:
            return state
        most = math.sqrt(self.settings.max_pixels / (camera.width * camera.height))
        scale = math.floor(min(_MADE_PX / length_px, _MOST_ENLARGED, most) / _SCALE_STEP) * _SCALE_STEP
        if scale <= 1:
            return state
        return replace(state, picture_scale=scale, shape_frames=None if state.shape_frames is None else ())

    def _remembered(
        self, state: TrackerState, proposed: Proposed | None, best: Candidate, scene: Scene, *, is_new: bool
    ) -> TrackerState:
        health, here = self.parts.health, self.parts.health.score(best)
        if proposed is not None and proposed.appearance is not None:
            state = replace(state, appearance=(proposed.appearance,))
        if proposed is not None and not state.has_started:
            shape = state.shape if proposed.shape is None else proposed.shape
            state = replace(state, shape=shape, posture=proposed.pose.dofs)
        usual = here if is_new and health.settings.memory == 1 else health.usual(best, state.usual_score)
        state = replace(
            state,
            hand=replace(best.hand, failures=0),
            last_seen=Keyframe(time_s=scene.time_s, pose=best.pose),
            usual_score=usual,
            best_score=max(here, _BEST_KEPT * state.best_score + (1 - _BEST_KEPT) * here),
            has_started=True,
        )
        return state if is_new else self._with_colours(state, best, scene)

    def _with_colours(self, state: TrackerState, best: Candidate, scene: Scene) -> TrackerState:
        """Colours learned from a scene that bears the hand out, where it is time for them."""
        every, count = self.settings.colour_update_every, state.frames_since_colours + 1
        is_sure = not self.parts.health.is_degraded(best, state.usual_score)
        if not is_sure or every == 0 or count < every or state.shape is None:
            return replace(state, frames_since_colours=count if is_sure else state.frames_since_colours)
        looks = self.parts.segmentation.learned(state.appearance, best.pose, state.shape, scene)
        return replace(state, appearance=looks, frames_since_colours=0)

    def _without(
        self, state: TrackerState, search: _Search, predicted: FollowedHand | None
    ) -> tuple[TrackerState, Estimate]:
        """A frame that bears no hand out; a followed one is carried on for a while."""
        best, is_new = search.best, search.proposed is not None
        hand = predicted
        if best is not None and not is_new and predicted is not None:
            kept = best.hand if best.if_failing is None else best.if_failing
            hand = None if self.parts.health.is_gone(best) else replace(kept, failures=predicted.failures)
        status: FrameStatus = "lost" if state.has_started and search.has_foreground else "no_hand"
        reason = search.reason
        if best is not None and not is_new:
            share = f"edges on {best.edges:.0%}, overlap {best.overlap:.2f}"
            reason = f"{share}, {best.in_view:.0%} in the picture"
        estimate = self._nothing(state, status, reason or "no hand was looked for in this frame")
        return replace(state, hand=self._failed(hand)), estimate

    def _failed(self, hand: FollowedHand | None) -> FollowedHand | None:
        if hand is None or hand.failures + 1 >= self.settings.health.patience:
            return None
        return replace(hand, failures=hand.failures + 1)

    def _nothing(self, state: TrackerState, status: FrameStatus, reason: str) -> Estimate:
        assert state.time_s is not None
        return Estimate(status=status, time_s=state.time_s, reason=reason)

    def _with_evidence(self, estimate: Estimate, told: Told, scene: Scene, state: TrackerState) -> Estimate:
        return self._with_qualities(estimate, self._evidence(told, self._segmented(scene, state)))

    def _with_qualities(self, estimate: Estimate, evidence: Float[Tensor, "5 evidence"]) -> Estimate:
        alone = "contour" if self.settings.method == "contour" else "distance"
        quality, fingers = qualities(evidence, alone if len(self.parts.cameras) == 1 else "rig")
        return replace(estimate, quality=quality, finger_quality=fingers, evidence=evidence)

    def _told(self, found: Candidate, state: TrackerState, scene: Scene, tip_std: Float[Tensor, "5"]) -> Told:
        """What the evidence of a hand's fingers is gathered from."""
        assert state.shape is not None
        return Told(
            pose=found.pose,
            placed=found.placed,
            shape=state.shape,
            tip_std=tip_std,
            agreement=found.agreement,
            keypoints=self.parts.keypoints(scene),
            learned=found.learned,
            direction=found.direction,
        )

    def _posed(
        self, status: FrameStatus, found: Candidate, state: TrackerState, scene: Scene
    ) -> tuple[Estimate, Float[Tensor, "5"]]:
        """The estimate without that evidence, and the standard deviations of the fingertips about the wrist."""
        assert state.shape is not None
        factor = self.parts.rule.overconfidence
        posed = posed_belief(
            found.hand, self.parts.motion, self.kinematics, state.shape, overconfidence=factor, frames=found.frames
        )
        covariance = posed.keypoints_cov + scale_covariance(posed.keypoints, self._scale_std)
        estimate = Estimate(
            status=status,
            time_s=scene.time_s,
            pose=posed.pose,
            pose_std=posed.pose_std,
            keypoints=posed.keypoints,
            keypoints_px=torch.stack([camera.project(posed.keypoints) for camera in self.own_cameras]),
            keypoints_cov=covariance if state.shape_keypoints_cov is None else covariance + state.shape_keypoints_cov,
            overlaps=found.agreement.overlaps,
            overlap=found.overlap,
            unexplained=found.agreement.most_unexplained,
            edges=found.edges,
            inside=found.inside,
            nis=found.nis,
            score=self.parts.health.score(found),
            views=found.agreement.views,
        )
        return estimate, posed.tip_std

    @cached_property
    def own_cameras(self) -> tuple[Camera, ...]:
        """The cameras in the tracker's world, as they take pictures; float64."""
        pairs = zip(self.cameras, self.parts.cameras, strict=True)
        with torch.inference_mode(False):  # kept for callers in any mode
            return tuple(
                replace(own.to(dtype=torch.float64), rotation=used.rotation, translation=used.translation)
                for own, used in pairs
            )

    def pose_of(self, state: TrackerState) -> HandPose | None:
        """Where a state's hand is believed to be; None while there is none."""
        return None if state.hand is None else self.parts.motion.pose(state.hand)


def _is_silent(scene: Scene) -> bool:
    """Whether detectors looked at all pictures there are, and found no hand."""
    return all(view.is_empty or view.is_detector_silent for view in scene.views)


def _out_of_reach(candidate: Candidate, state: TrackerState, scene: Scene) -> str:
    """Why a hand cannot be the one that was seen last, in the time since; empty where it may be."""
    if state.last_seen is None:
        return ""
    passed_s = scene.time_s - state.last_seen.time_s
    apart_m = float((candidate.pose.dofs[:3] - state.last_seen.pose.dofs[:3]).norm())
    if apart_m <= _FASTEST_M_PER_S * passed_s + _JUMP_M:
        return ""
    return f"what looks like a hand is {apart_m:.1f} m from where it was {passed_s:.2f} s before"
