"""The contour tracker of paper 003: predict, project, find edges along normals, update; notice when it is lost.

A tracker is a value: `step` takes a state and a picture and returns the next state and the frame's estimate.
"""

import copy
import math
from dataclasses import replace
from typing import Any

import cv2
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from torchhand.geometry import Camera
from torchhand.hand import HandKinematics, PoseSpace, named_pose_space, posture
from torchhand.image import BackgroundPlate
from torchhand.numerics import Gaussian, predict_linear
from torchhand.track.appearance import Agreement, Appearance, grey, hand_region, overlap, touching, unexplained_px
from torchhand.track.contour_points import hand_length_px
from torchhand.track.estimate import estimate_of, unknown_scale_std
from torchhand.track.measurement import ContourMeasurement, Measured, Planes
from torchhand.track.prior import kind_of, posture_prior
from torchhand.track.settings import ContourTrackerSettings
from torchhand.track.start import NoStart, Start, StartPoints, find_hand, start_at_points
from torchhand.track.state import Estimate, Memory, Status, TrackerState, restored_state, saved_state
from torchhand.view import HandProjector, outline_table

__all__ = ["ContourTracker", "Estimate", "Memory", "Status", "TrackerState"]

_START_STD = {"translation": 0.003, "rotation": 0.03, "angle": 0.08}  # m, rad, rad
_START_SPEED = {"translation": 0.2, "rotation": 1.0, "angle": 1.0}  # per second
_START_ACCELERATION = {"translation": 2.0, "rotation": 10.0, "angle": 10.0}  # per second squared
_SETTLING = 4  # measurement updates on the starting picture
_REACH = 1.3  # silhouettes are compared so far from the wrist, hand lengths
_FINGER = 0.03  # radius of a disc that fits into every finger, hand lengths


class ContourTracker:
    """Follows one hand of a known side through the pictures of one camera. Poses are in the camera's frame.

    Computes in float64 on the CPU. The same pictures give the same numbers bit for bit.
    """

    def __init__(
        self,
        kinematics: HandKinematics,
        camera: Camera,
        frames_per_second: float,
        settings: ContourTrackerSettings | None = None,
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
        self.settings = settings or ContourTrackerSettings()
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
        self._measurement = ContourMeasurement(
            settings=s,
            camera=self.camera,
            space=self.space,
            table=self.table,
            prior=posture_prior(self.space, s.prior),
            skeleton=self.kinematics.skeleton,
        )
        self._kinds = [kind_of(name) for name in self.space.free_names]
        dt = 1.0 / frames_per_second
        self._transition = s.motion.transition(dt, self.space.size)
        noise = {"translation": s.noise.translation, "rotation": s.noise.rotation, "angle": s.noise.angle}
        density = torch.tensor([noise[kind] ** 2 for kind in self._kinds], dtype=torch.float64)
        self._process_noise = s.motion.process_noise(dt, density)
        self._check_camera = self.camera.resized(min(1.0, s.check_side_px / max(camera.width, camera.height)))
        self._scale_std = unknown_scale_std(
            self.kinematics.shape_space, self.camera, is_shape_known=self.known_shape is not None
        )
        self._projectors: tuple[HandProjector, HandProjector] | None = None

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
        if is_sure or (following is not None and not is_due):
            return following, memory, estimate
        # Lost, or in doubt: a hand in the posture of the start, seen afresh, takes over where it explains more.
        memory = replace(memory, frames_since_search=0)
        restarted, remembered, found = self._restart(memory, image)
        margin = 0.0 if following is None else self.settings.loss.better_by
        if restarted is not None and (found.overlap or 0.0) > (estimate.overlap or 0.0) + margin:
            return restarted, remembered, replace(found, status="tracked")  # no frame was lost
        return following, memory, estimate

    def _is_doubtful(self, estimate: Estimate, memory: Memory) -> bool:
        loss = self.settings.loss
        has_dropped = (estimate.overlap or 0.0) < memory.overlap - loss.doubt_drop
        return has_dropped or (estimate.unexplained or 0.0) > loss.doubt_unexplained

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

    def _settled(self, start: Start, image: Tensor) -> tuple[Measured, Agreement]:
        """The tracker's own estimate of the starting picture, and how it agrees with it.

        The fit has more freedom and other weights, and a track that went on from it would begin with a slide.
        """
        state = self._state_of(start)
        spread = state.belief.covariance
        projector, _ = self._projectors_of(start.fit.shape)
        probability = start.appearance.probability(image)
        planes = self._planes(image, probability)
        settled = Measured(state=state)
        for _ in range(_SETTLING):
            belief = Gaussian(settled.state.belief.mean, spread)
            settled = self._measurement.update(replace(settled.state, belief=belief), projector, planes)
        # Innovations of repeated updates on one picture say nothing.
        return replace(settled, nis=None), self._agreement(settled.state, start.fit.shape, probability)

    def _state_of(self, start: Start) -> TrackerState:
        fit = start.fit
        spreads = [
            torch.tensor([table[kind] for kind in self._kinds], dtype=torch.float64) ** 2
            for table in (_START_STD, _START_SPEED, _START_ACCELERATION)[: self.settings.motion.order + 1]
        ]
        mean = torch.zeros(len(spreads) * self.space.size, dtype=torch.float64)
        return TrackerState(
            belief=Gaussian(mean, torch.diag(torch.cat(spreads))),
            base=fit.pose,
            reference=fit.root_reference,
            start_reference=fit.root_reference,
        )

    # ------------------------------------------------------------------ following

    def _follow(
        self, state: TrackerState, shape: Tensor, appearance: Appearance, image: Tensor
    ) -> tuple[TrackerState | None, Estimate]:
        s = self.settings
        projector, _ = self._projectors_of(shape)
        probability = appearance.probability(image)
        planes = self._planes(image, probability)
        measured = Measured(state=self._predicted(state))
        for _ in range(s.passes):
            measured = self._measurement.update(measured.state, projector, planes, measured.seen)
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
        return replace(state, belief=predict_linear(state.belief, self._transition, self._process_noise))

    def _planes(self, image: Tensor, probability: Tensor) -> Planes:
        s = self.settings
        has_inner = s.inner_weight > 0
        luminance = grey(image) if s.edges_in == "grey" or has_inner else None
        outer = luminance if s.edges_in == "grey" and luminance is not None else probability
        return Planes(outer=outer, inner=luminance if has_inner else None)

    def _agreement(self, state: TrackerState, shape: Tensor, probability: Tensor) -> Agreement:
        """Comparison with the picture's silhouette, in the reduced picture; pieces apart from the hand do not count."""
        camera, (_, projector) = self._check_camera, self._projectors_of(shape)
        pose = self.space.about(state.base).dof(state.belief.mean[: self.space.size])
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
