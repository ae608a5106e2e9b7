"""What the trackers share: start and restart, the tests by which a track is kept or lost, what is told of a frame.

A tracker is a value: `step` takes a state and a picture and returns the next state and the frame's estimate.
"""

import copy
import math
from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Any, Generic, TypeVar

import cv2
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from torchhand.geometry import Camera
from torchhand.hand import HandKinematics, PoseSpace, named_pose_space, posture
from torchhand.image import BackgroundPlate
from torchhand.numerics import Gaussian, predict_linear, single_threaded
from torchhand.track.appearance import Agreement, Appearance, hand_region, overlap, relearned, touching, unexplained_px
from torchhand.track.contour_points import hand_length_px
from torchhand.track.estimate import estimate_of, unknown_scale_std
from torchhand.track.facing import shows_same_side
from torchhand.track.measured import Measured
from torchhand.track.prior import Kind, kind_of
from torchhand.track.rebasing import Rebasing
from torchhand.track.settings import TrackerSettings
from torchhand.track.start import NoStart, Start, StartPoints, find_hand, start_at_points
from torchhand.track.state import Estimate, Memory, Status, TrackerState, restored_state, saved_state
from torchhand.view import HandProjector, outline_table

Settings = TypeVar("Settings", bound=TrackerSettings)

_START_STD = {"translation": 0.003, "rotation": 0.03, "angle": 0.08}  # m, rad, rad
_START_SPEED = {"translation": 0.2, "rotation": 1.0, "angle": 1.0}  # per second
_START_ACCELERATION = {"translation": 2.0, "rotation": 10.0, "angle": 10.0}  # per second squared
_REACH = 1.3  # silhouettes are compared so far from the wrist, hand lengths
_MARGIN = 0.015  # along the outline, colours are nobody's, hand lengths
_FINGER = 0.03  # radius of a disc that fits into every finger, hand lengths


def start_spread(kinds: list[Kind], order: int) -> Float[Tensor, "state"]:
    """Variances of a state at its start: parameters of some kinds, then their rates."""
    spreads = [
        torch.tensor([table[kind] for kind in kinds], dtype=torch.float64) ** 2
        for table in (_START_STD, _START_SPEED, _START_ACCELERATION)[: order + 1]
    ]
    return torch.cat(spreads)


class HandTracker(ABC, Generic[Settings]):
    """Follows one hand of a known side through the pictures of one camera. Poses are in the camera's frame.

    Computes in float64 on the CPU. The same pictures give the same numbers bit for bit.
    """

    def __init__(
        self,
        kinematics: HandKinematics,
        camera: Camera,
        frames_per_second: float,
        settings: Settings,
        *,
        shape: Float[Tensor, "shape"] | None = None,
        start_points: StartPoints | None = None,
        plate: BackgroundPlate | None = None,
    ) -> None:
        """shape: proportions where they are known; else they are fitted to the first picture with a hand.

        start_points: where the hand is in the first picture, given by the user, in place of a search.
        plate: the empty scene, for the silhouette method "background".
        Raises ValueError for a frame rate that cannot be, and where that method lacks its plate.
        """
        if not (math.isfinite(frames_per_second) and frames_per_second > 0):
            raise ValueError(f"frames_per_second: expected a finite number above 0, got {frames_per_second!r}")
        self.settings: Settings = settings
        is_exact = kinematics.default_shape.dtype == torch.float64
        self.kinematics = kinematics if is_exact else copy.deepcopy(kinematics).double()  # the caller's stays as it is
        eye, zero = torch.eye(3, dtype=torch.float64), torch.zeros(3, dtype=torch.float64)
        self.camera = replace(camera.to(dtype=torch.float64), rotation=eye, translation=zero)
        self.start_points = start_points
        if self.settings.silhouette.method == "background" and plate is None:
            raise ValueError("silhouette.method: 'background' needs a plate of the empty scene")
        self.plate = plate
        self.known_shape = None if shape is None else shape.double()
        self.space: PoseSpace = named_pose_space(self.settings.pose_space)
        s = self.settings
        self.table = outline_table(s.points_per_generator, s.points_per_arc, without=("palm_wrist",))
        self._rebased = Rebasing(space=self.space, skeleton=self.kinematics.skeleton)
        self._kinds: list[Kind] = [kind_of(name) for name in self.space.free_names]
        self._dt_s = 1.0 / frames_per_second
        noise = {"translation": s.noise.translation, "rotation": s.noise.rotation, "angle": s.noise.angle}
        self._density = torch.tensor([noise[kind] ** 2 for kind in self._kinds], dtype=torch.float64)
        self._transition = s.motion.transition(self._dt_s, self.space.size)
        self._process_noise = self._noise_of(self._density)
        self._check_camera = self.camera.resized(min(1.0, s.check_side_px / max(camera.width, camera.height)))
        self._scale_std = unknown_scale_std(
            self.kinematics.shape_space, self.camera, is_shape_known=self.known_shape is not None
        )
        self._projectors: tuple[HandProjector, HandProjector] | None = None

    @single_threaded()
    def step(
        self, state: TrackerState | None, memory: Memory, image: UInt8[Tensor, "height width 3"]
    ) -> tuple[TrackerState | None, Memory, Estimate]:
        """The next state, what is remembered, and the estimate of this picture (RGB).

        A hand found again after a frame that was lost is `recovered`; the first one ever, and one that a fresh search
        corrects within an unbroken track, is `tracked`. A frame that fails the tests is searched afresh at once, a
        doubtful one when a search is due. Raises ValueError for a picture that is not the camera's size.
        """
        if image.shape[:2] != (self.camera.height, self.camera.width):
            expected = f"{self.camera.width}×{self.camera.height} px as the camera says"
            raise ValueError(f"image: expected {expected}, got {image.shape[1]}×{image.shape[0]} px")
        if state is None or memory.appearance is None or memory.shape is None:
            return self._restart(memory, image)
        following, estimate = self._follow(state, memory.shape, memory.appearance, image)
        is_failing = following is not None and following.failures > 0
        is_due = is_failing or memory.frames_since_search + 1 >= self.settings.loss.search_every
        memory = replace(memory, frames_since_search=memory.frames_since_search + 1)
        is_sure = following is not None and not self._is_doubtful(estimate, memory)
        if following is not None and is_sure and not is_failing:
            memory = self._learned(memory, following, image)
        if is_sure or (following is not None and not is_due):
            return following, memory, estimate
        # Lost, or in doubt: a hand in the posture of the start, seen afresh, takes over where it explains more.
        memory = replace(memory, frames_since_search=0)
        restarted, remembered, found = self._restart(memory, image)
        if restarted is None:
            return following, memory, estimate
        margin = 0.0
        if following is not None:
            is_same_side = shows_same_side(restarted.reference, state.reference)
            margin = self.settings.loss.better_by if is_same_side else self.settings.loss.turned_by
        if (found.overlap or 0.0) > (estimate.overlap or 0.0) + margin:
            return restarted, remembered, replace(found, status="tracked")  # no frame was lost
        return following, memory, estimate

    def _is_doubtful(self, estimate: Estimate, memory: Memory) -> bool:
        loss = self.settings.loss
        has_dropped = (estimate.overlap or 0.0) < memory.overlap - loss.doubt_drop
        return has_dropped or (estimate.unexplained or 0.0) > loss.doubt_unexplained

    def _learned(self, memory: Memory, state: TrackerState, image: Tensor) -> Memory:
        """The memory with the colours of a picture that bears out a state, where it is time for them."""
        light, count = self.settings.light, memory.frames_since_lesson + 1
        if count < light.every or light.every == 0 or memory.appearance is None or memory.shape is None:
            return replace(memory, frames_since_lesson=count)
        pose = self._rebased.pose(state)
        model = self._projectors_of(memory.shape)[0].silhouette(pose, state.reference)
        margin = max(1, round(_MARGIN * hand_length_px(self.camera, self.kinematics, pose, memory.shape)))
        probability = memory.appearance.probability(image)
        learned = relearned(memory.appearance, image, probability, model, margin, keep=light.keep)
        return replace(memory, appearance=learned, frames_since_lesson=0)

    def skip(self, state: TrackerState | None) -> tuple[TrackerState | None, Estimate]:
        """The step over a picture that could not be read: time passes, nothing is seen.

        The state is predicted; after `loss.patience` such frames in a row the track is given up.
        """
        if state is not None:
            failures = state.failures + 1
            is_given_up = failures >= self.settings.loss.patience
            state = None if is_given_up else replace(self._predicted(state), failures=failures)
        return state, Estimate(status="no_hand", reason="the picture could not be read")

    def state_dict(self, state: TrackerState | None, memory: Memory) -> dict[str, Any]:
        """Plain tensors and numbers from which `restore` goes on exactly."""
        return saved_state(state, memory)

    def restore(self, saved: dict[str, Any]) -> tuple[TrackerState | None, Memory]:
        """The inverse of `state_dict`."""
        return restored_state(saved)

    # ------------------------------------------------------------------ start and restart

    def _restart(self, memory: Memory, image: Tensor) -> tuple[TrackerState | None, Memory, Estimate]:
        s = self.settings
        is_first = memory.appearance is None
        found = self._found(memory, image)
        if isinstance(found, NoStart):
            status: Status = "lost" if found.has_foreground and memory.shape is not None else "no_hand"
            return None, memory, Estimate(status=status, reason=found.reason)
        settled, agreement = self._settled(found, image)
        if settled.found < s.loss.min_found or agreement.overlap < s.loss.min_overlap:
            shares = f"edges on {settled.found:.0%}, overlap {agreement.overlap:.2f}"
            reason = f"no hand where the search began ({shares})"
            return None, memory, Estimate(status="no_hand" if is_first else "lost", reason=reason)
        memory = replace(memory, overlap=agreement.overlap)
        if is_first:
            memory = replace(memory, shape=found.fit.shape, appearance=found.appearance, posture=found.fit.pose)
        status = "tracked" if is_first else "recovered"
        return settled.state, memory, self._estimate(status, settled, found.fit.shape, agreement)

    def _found(self, memory: Memory, image: Tensor) -> Start | NoStart:
        s = self.settings
        shape = self.known_shape if self.known_shape is not None else self.kinematics.default_shape
        shape = memory.shape if memory.shape is not None else shape
        where = (self.kinematics, self.camera, shape, self.table)
        is_first = memory.appearance is None
        if is_first and self.start_points is not None:
            return start_at_points(
                image,
                self.start_points,
                *where,
                posture(s.posture),
                fit_shape=self.known_shape is None,
                settings=s.fit,
            )
        return find_hand(
            image,
            *where,
            memory.posture if memory.posture is not None else posture(s.posture),
            appearance=memory.appearance,
            fit_shape=is_first and self.known_shape is None,
            settings=s.fit,
            min_overlap=s.loss.start_overlap,
            silhouette=s.silhouette,
            plate=self.plate,
        )

    @abstractmethod
    def _settle(self, state: TrackerState, start: Start, image: Tensor, probability: Tensor) -> Measured:
        """The tracker's own estimate of the starting picture.

        The fit has more freedom and other weights, and a track that went on from it would begin with a slide.
        """

    def _settled(self, start: Start, image: Tensor) -> tuple[Measured, Agreement]:
        """The settled start, and how it agrees with the picture."""
        probability = start.appearance.probability(image)
        settled = self._settle(self._state_of(start), start, image, probability)
        # Innovations of repeated updates on one picture say nothing.
        return replace(settled, nis=None), self._agreement(settled.state, start.fit.shape, probability)

    def _state_of(self, start: Start) -> TrackerState:
        fit = start.fit
        spread = start_spread(self._kinds, self.settings.motion.order)
        return TrackerState(
            belief=Gaussian(torch.zeros_like(spread), spread.diag_embed()),
            base=fit.pose,
            reference=fit.root_reference,
            start_reference=fit.root_reference,
        )

    # ------------------------------------------------------------------ following

    @abstractmethod
    def _measure(self, state: TrackerState, shape: Tensor, image: Tensor, probability: Tensor) -> Measured:
        """The state of the frame before, carried on to this picture."""

    def _follow(
        self, state: TrackerState, shape: Tensor, appearance: Appearance, image: Tensor
    ) -> tuple[TrackerState | None, Estimate]:
        s = self.settings
        probability = appearance.probability(image)
        measured = self._measure(state, shape, image, probability)
        found, inside = measured.found, measured.inside
        agreement = self._agreement(measured.state, shape, probability)
        is_good = found >= s.loss.min_found and inside >= s.loss.min_inside and agreement.overlap >= s.loss.min_overlap
        failures = 0 if is_good else state.failures + 1
        is_gone = inside < 0.5 * s.loss.min_inside or agreement.overlap < 0.5 * s.loss.min_overlap
        if failures >= s.loss.patience or is_gone:
            reason = f"edges on {found:.0%}, overlap {agreement.overlap:.2f}, {inside:.0%} in the picture"
            return None, Estimate(status="lost", reason=reason)
        measured = replace(measured, state=replace(measured.state, failures=failures))
        return measured.state, self._estimate("tracked", measured, shape, agreement)

    def _projectors_of(self, shape: Tensor) -> tuple[HandProjector, HandProjector]:
        """Projectors into the picture and into the reduced one, kept while the proportions stay the same."""
        if self._projectors is None or self._projectors[0].shape is not shape:
            full = HandProjector(self.kinematics, self.camera, shape)
            self._projectors = (full, HandProjector(self.kinematics, self._check_camera, shape))
        return self._projectors

    def _predicted(self, state: TrackerState) -> TrackerState:
        noise = self._process_noise if state.density is None else self._noise_of(state.density)
        return replace(state, belief=predict_linear(state.belief, self._transition, noise))

    def _noise_of(self, density: Tensor) -> Tensor:
        return self.settings.motion.process_noise(self._dt_s, density)

    def _agreement(self, state: TrackerState, shape: Tensor, probability: Tensor) -> Agreement:
        """Comparison with the picture's silhouette, in the reduced picture; pieces apart from the hand do not count."""
        camera, (_, projector) = self._check_camera, self._projectors_of(shape)
        pose = self._rebased.pose(state)
        small = cv2.resize(probability.numpy(), (camera.width, camera.height), interpolation=cv2.INTER_AREA)
        frames = projector.frames(pose, state.reference)
        keypoints = camera.project(frames.keypoints)
        length_px = hand_length_px(camera, self.kinematics, pose, shape)
        region = hand_region((camera.height, camera.width), keypoints[0], keypoints[9], _REACH * length_px)
        model = projector.silhouette_of(projector.primitives_cam(frames))
        picture = touching(torch.from_numpy(small > 0.5), model)
        return Agreement(
            overlap=overlap(model, picture, region),
            unexplained=unexplained_px(model, picture, region, _FINGER * length_px) / length_px**2,
        )

    def _estimate(self, status: Status, measured: Measured, shape: Tensor, agreement: Agreement) -> Estimate:
        return estimate_of(
            status,
            measured.state,
            self.kinematics,
            self.space,
            self.camera,
            shape,
            scale_std=self._scale_std,
            agreement=agreement,
            found=measured.found,
            nis=measured.nis,
        )
