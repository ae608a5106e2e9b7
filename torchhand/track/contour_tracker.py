"""The contour tracker of paper 003: predict, project, find edges along the contour's normals, update; notice when it is lost.

A tracker is a value: `step` takes a state and a picture and returns the next state and the frame's estimate.
"""

from dataclasses import dataclass, replace
from typing import Any, Literal

import cv2
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from torchhand.geometry import Camera, rotation_from_vector, vector_from_rotation
from torchhand.hand import DOFS, HandKinematics, PoseSpace, named_pose_space, posture
from torchhand.image import ColourModel, search_edges
from torchhand.numerics import Gaussian, predict_linear, update
from torchhand.track.appearance import Appearance, grey, hand_region, overlap
from torchhand.track.fit import hand_length_px, outer_points
from torchhand.track.limits import clamp_to_limits
from torchhand.track.settings import ContourTrackerSettings
from torchhand.track.start import NoStart, Start, StartPoints, find_hand, start_at_points
from torchhand.view import HandProjector, outline_table

Status = Literal["tracked", "lost", "recovered", "no_hand"]

_START_STD = {"translation": 0.003, "rotation": 0.03, "angle": 0.08}  # m, rad, rad
_START_SPEED = {"translation": 0.2, "rotation": 1.0, "angle": 1.0}  # per second
_START_ACCELERATION = {"translation": 2.0, "rotation": 10.0, "angle": 10.0}  # per second squared


@dataclass(frozen=True, kw_only=True)
class TrackerState:
    """Everything the tracker knows between two frames while it follows a hand."""

    belief: Gaussian
    """Over [free, free', free'']: changes from `base`, the root's rotation a left perturbation of `reference`."""
    base: Float[Tensor, "36"]
    """Pose of the start."""
    reference: Float[Tensor, "3 3"]
    """cam_from_hand of the last estimate."""
    start_reference: Float[Tensor, "3 3"]
    """cam_from_hand of the start."""
    failures: int = 0
    """Frames in a row that failed the tests."""


@dataclass(frozen=True, kw_only=True)
class Memory:
    """What outlasts a loss."""

    shape: Float[Tensor, "shape"] | None = None
    """The fitted proportions."""
    appearance: Appearance | None = None
    posture: Float[Tensor, "36"] | None = None
    """The posture of the start as it was fitted, which a restart looks for."""
    frames_since_search: int = 0
    """Frames since a doubtful track was last compared with a fresh search."""


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """One frame's result. Where status is lost or no_hand everything but the reason is None."""

    status: Status
    pose: Float[Tensor, "36"] | None = None
    """Full pose in the camera frame with the root's rotation vector."""
    pose_std: Float[Tensor, "36"] | None = None
    root_rotation: Float[Tensor, "3 3"] | None = None
    """cam_from_hand"""
    keypoints: Float[Tensor, "21 3"] | None = None
    keypoints_px: Float[Tensor, "21 2"] | None = None
    keypoints_cov: Float[Tensor, "21 3 3"] | None = None
    overlap: float | None = None
    """Intersection over union with the picture's silhouette, forearm cut at the wrist."""
    found: float | None = None
    """Share of the outer contour with an accepted edge."""
    nis: float | None = None
    """Normalised innovation squared per accepted edge."""
    reason: str = ""
    """Why a frame is lost or without a hand."""


class ContourTracker:
    """Follows one hand of a known side through the pictures of one camera. Poses are in the camera's frame."""

    def __init__(
        self,
        kinematics: HandKinematics,
        camera: Camera,
        frames_per_second: float,
        settings: ContourTrackerSettings | None = None,
        *,
        shape: Float[Tensor, "shape"] | None = None,
        start_points: StartPoints | None = None,
    ) -> None:
        self.settings = settings or ContourTrackerSettings()
        self.kinematics = kinematics.double()
        eye, zero = torch.eye(3, dtype=torch.float64), torch.zeros(3, dtype=torch.float64)
        self.camera = replace(camera.to(dtype=torch.float64), rotation=eye, translation=zero)
        self.start_points = start_points
        self.known_shape = shape
        self.space: PoseSpace = named_pose_space(self.settings.pose_space)
        s = self.settings
        self.table = outline_table(s.points_per_generator, s.points_per_arc, without=("palm_wrist",))
        self._kinds = [_kind(name) for name in self.space.free_names]
        dt = 1.0 / frames_per_second
        self._transition = s.motion.transition(dt, self.space.size)
        root = {"translation": s.noise.translation, "rotation": s.noise.rotation, "angle": s.noise.angle}
        density = torch.tensor([root[kind] ** 2 for kind in self._kinds], dtype=torch.float64)
        self._process_noise = s.motion.process_noise(dt, density)
        self._check_scale = min(1.0, s.check_side_px / max(camera.width, camera.height))
        self._check_camera = self.camera.resized(self._check_scale)
        self._prior_rows = _prior_rows(self.space, s)

    # ------------------------------------------------------------------ one frame

    def step(
        self, state: TrackerState | None, memory: Memory, image: UInt8[Tensor, "height width 3"]
    ) -> tuple[TrackerState | None, Memory, Estimate]:
        """The next state, what is remembered, and the estimate of this picture.

        A hand found again after a frame that was lost is `recovered`; the first one ever, and one that a fresh search
        corrects within an unbroken track, is `tracked`.
        """
        if state is None or memory.appearance is None or memory.shape is None:
            return self._restart(memory, image)
        following, estimate = self._follow(state, memory.shape, memory.appearance, image)
        is_due = memory.frames_since_search + 1 >= self.settings.loss.search_every
        memory = replace(memory, frames_since_search=memory.frames_since_search + 1)
        is_sure = following is not None and (estimate.overlap or 0.0) >= self.settings.loss.doubt_overlap
        if is_sure or (following is not None and not is_due):
            return following, memory, estimate
        # Lost, or in doubt: a hand in the posture of the start, seen afresh, takes over where it explains more.
        restarted, remembered, found = self._restart(replace(memory, frames_since_search=0), image)
        margin = 0.0 if following is None else self.settings.loss.better_by
        if restarted is not None and (found.overlap or 0.0) > (estimate.overlap or 0.0) + margin:
            return restarted, remembered, replace(found, status="tracked")  # no frame was lost
        return following, replace(memory, frames_since_search=0), estimate

    def skip(self, state: TrackerState | None) -> tuple[TrackerState | None, Estimate]:
        """The step over a picture that could not be read: time passes, nothing is seen."""
        if state is not None:
            belief = predict_linear(state.belief, self._transition, self._process_noise)
            failures = state.failures + 1
            state = None if failures >= self.settings.loss.patience else replace(state, belief=belief, failures=failures)
        return state, Estimate(status="no_hand", reason="the picture could not be read")

    def _restart(self, memory: Memory, image: Tensor) -> tuple[TrackerState | None, Memory, Estimate]:
        s = self.settings
        is_first = memory.appearance is None
        shape = self.known_shape if self.known_shape is not None else self.kinematics.default_shape
        shape = memory.shape if memory.shape is not None else shape
        if is_first and self.start_points is not None:
            found = start_at_points(
                image, self.start_points, self.kinematics, self.camera, shape, self.table, posture(s.posture), settings=s.fit
            )
        else:
            found = find_hand(
                image,
                self.kinematics,
                self.camera,
                shape,
                self.table,
                memory.posture if memory.posture is not None else posture(s.posture),
                appearance=memory.appearance,
                fit_shape=is_first and self.known_shape is None,
                settings=s.fit,
                min_overlap=s.loss.start_overlap,
            )
        if isinstance(found, NoStart):
            was_tracked = memory.shape is not None
            status: Status = "lost" if found.has_foreground and was_tracked else "no_hand"
            return None, memory, Estimate(status=status, reason=found.reason)
        if is_first:
            memory = replace(memory, shape=found.fit.shape, appearance=found.appearance, posture=found.fit.pose)
        state, share, agreement = self._settled(found, image)
        status = "tracked" if is_first else "recovered"
        return state, memory, self._estimate(status, state, found.fit.shape, overlap_=agreement, found=share)

    def _settled(self, start: Start, image: Tensor) -> tuple[TrackerState, float, float]:
        """The tracker's own estimate of the starting picture: the fit has more freedom and other weights, and a track that
        went on from it would begin with a slide."""
        state = self._state_of(start)
        spread = state.belief.covariance
        projector = HandProjector(self.kinematics, self.camera, start.fit.shape)
        probability = start.appearance.probability(image)
        outer_plane, inner_plane = self._planes(image, probability)
        share = 0.0
        for _ in range(_SETTLING):
            state = replace(state, belief=Gaussian(state.belief.mean, spread))
            state, share, _, _ = self._measure(state, projector, outer_plane, inner_plane)
        return state, share, self._agreement(state, start.fit.shape, probability)

    def _planes(self, image: Tensor, probability: Tensor) -> tuple[Tensor, Tensor | None]:
        """The pictures in which outer and inner contours are searched."""
        s = self.settings
        luminance = grey(image) if s.edges_in == "grey" or s.inner_weight > 0 else None
        outer = luminance if s.edges_in == "grey" and luminance is not None else probability
        return outer, luminance if s.inner_weight > 0 else None

    def _state_of(self, start: Start) -> TrackerState:
        fit = start.fit
        spreads = [
            torch.tensor([table[kind] for kind in self._kinds], dtype=torch.float64) ** 2
            for table in (_START_STD, _START_SPEED, _START_ACCELERATION)[: self.settings.motion.order + 1]
        ]
        return TrackerState(
            belief=Gaussian(
                torch.zeros(len(spreads) * self.space.size, dtype=torch.float64), torch.diag(torch.cat(spreads))
            ),
            base=fit.pose,
            reference=fit.root_reference,
            start_reference=fit.root_reference,
        )

    def _follow(
        self, state: TrackerState, shape: Tensor, appearance: Appearance, image: Tensor
    ) -> tuple[TrackerState | None, Estimate]:
        s = self.settings
        projector = HandProjector(self.kinematics, self.camera, shape)
        probability = appearance.probability(image)
        outer_plane, inner_plane = self._planes(image, probability)
        belief = predict_linear(state.belief, self._transition, self._process_noise)
        state = replace(state, belief=belief)
        found, inside, nis = 0.0, 0.0, 0.0
        for _ in range(s.passes):
            state, found, inside, nis = self._measure(state, projector, outer_plane, inner_plane)
        agreement = self._agreement(state, shape, probability)
        is_good = found >= s.loss.min_found and inside >= s.loss.min_inside and agreement >= s.loss.min_overlap
        failures = 0 if is_good else state.failures + 1
        if failures >= s.loss.patience or inside < 0.5 * s.loss.min_inside or agreement < 0.5 * s.loss.min_overlap:
            reason = f"edges on {found:.0%}, overlap {agreement:.2f}, {inside:.0%} in the picture"
            return None, Estimate(status="lost", reason=reason)
        state = replace(state, failures=failures)
        return state, self._estimate("tracked", state, shape, overlap_=agreement, found=found, nis=nis)

    def _measure(
        self, state: TrackerState, projector: HandProjector, outer_plane: Tensor, inner_plane: Tensor | None
    ) -> tuple[TrackerState, float, float, float]:
        """One measurement update; returns the shares of outer points with an edge and of points in the picture, and NIS."""
        s, camera = self.settings, self.camera
        count = self.space.size
        space = self.space.about(state.base)
        pose = space.dof(state.belief.mean[:count])
        contour = projector.contour(pose, state.reference, self.table)
        length_px = hand_length_px(camera, pose, projector.shape)
        points, normals = contour.points_px[contour.visible], contour.normals[contour.visible]
        in_picture = (
            (points[:, 0] >= 0) & (points[:, 1] >= 0) & (points[:, 0] <= camera.width - 1) & (points[:, 1] <= camera.height - 1)
        )
        if int(in_picture.sum()) < 10:
            return state, 0.0, 0.0, 0.0
        silhouette = projector.silhouette(pose, state.reference)
        is_outer = outer_points(projector, silhouette, points, normals, 0.02 * length_px + 1)
        half_length = torch.full((len(points),), max(4.0, s.search_share * length_px), dtype=torch.float64)
        half_length = half_length * (1 + 0.5 * state.failures)
        edges = search_edges(outer_plane, points, normals, s.outer_edges, half_length_px=half_length)
        offset, is_found, rivals = edges.offset_px, edges.found & is_outer, edges.candidates
        weight = torch.ones_like(offset)
        if inner_plane is not None:
            inner = search_edges(inner_plane, points, normals, s.inner_edges, half_length_px=0.6 * half_length)
            offset = torch.where(is_outer, offset, inner.offset_px)
            is_found = torch.where(is_outer, edges.found, inner.found)
            rivals = torch.where(is_outer, rivals, inner.candidates)
            weight = torch.where(is_outer, weight, s.inner_weight)
        chosen = self.table.select(contour.visible)

        def observe(candidates: Tensor) -> Tensor:
            pixels = projector.outline_px(space.dof(candidates), state.reference, chosen)
            return torch.cat(((pixels * normals).sum(-1), candidates @ matrix.T), -1)

        matrix, prior_value, prior_variance = self._prior(state)
        measurement = torch.cat(((points * normals).sum(-1) + offset, prior_value))
        variance = torch.cat((s.edge_std_px**2 * rivals.clamp_min(1) / weight, prior_variance)) * s.passes
        valid = torch.cat((is_found, torch.ones_like(prior_value, dtype=torch.bool)))
        result = update(
            state.belief, observe, measurement, variance, s.unscented, valid=valid, gate=s.gate, observed=count
        )
        accepted = result.used[: len(points)] & is_outer
        outer_count = max(1, int((is_outer & in_picture).sum()))
        moved = self._rebased(replace(state, belief=result.state))
        nis = float(result.nis) / max(1, int(result.count))
        return moved, int(accepted.sum()) / outer_count, float(in_picture.float().mean()), nis

    def _prior(self, state: TrackerState) -> tuple[Tensor, Tensor, Tensor]:
        """Weak linear measurements of the free parameters: matrix, values, variances."""
        matrix, variance, tilt_rows = self._prior_rows
        value = torch.zeros(len(variance), dtype=torch.float64)
        if tilt_rows:
            turned = vector_from_rotation(state.reference @ state.start_reference.T)
            for row, axis in tilt_rows:
                value[row] = -turned[axis]
        return matrix, value, variance

    def _rebased(self, state: TrackerState) -> TrackerState:
        """Joint limits kept; the root's rotation moved from the belief's mean into the reference."""
        count = self.space.size
        free = state.belief.mean[:count]
        space = self.space.about(state.base)
        pose = clamp_to_limits(space.dof(free), self.kinematics.skeleton)
        kept = space.free(pose)
        is_rotation = torch.tensor([kind == "rotation" for kind in self._kinds])
        kept = torch.where(is_rotation, torch.zeros_like(kept), kept)
        mean = state.belief.mean.clone()
        hit = (kept - free).abs() > 1e-9
        mean[:count] = kept
        for block in range(1, len(mean) // count):  # a joint at its limit stops there
            rates = mean[block * count : (block + 1) * count]
            mean[block * count : (block + 1) * count] = torch.where(hit & ~is_rotation, torch.zeros_like(rates), rates)
        return replace(
            state,
            belief=Gaussian(mean, state.belief.covariance),
            reference=rotation_from_vector(pose[3:6]) @ state.reference,
        )

    def _agreement(self, state: TrackerState, shape: Tensor, probability: Tensor) -> float:
        """Silhouette agreement in the reduced picture."""
        camera = self._check_camera
        projector = HandProjector(self.kinematics, camera, shape)
        pose = self.space.about(state.base).dof(state.belief.mean[: self.space.size])
        small = cv2.resize(probability.numpy(), (camera.width, camera.height), interpolation=cv2.INTER_AREA)
        keypoints = camera.project(projector.frames(pose, state.reference).keypoints)
        reach = 1.3 * hand_length_px(camera, pose, shape)
        region = hand_region((camera.height, camera.width), keypoints[0], keypoints[9], reach)
        return overlap(projector.silhouette(pose, state.reference), torch.from_numpy(small > 0.5), region)

    def _estimate(
        self, status: Status, state: TrackerState, shape: Tensor, *, overlap_: float, found: float, nis: float | None = None
    ) -> Estimate:
        count = self.space.size
        space = self.space.about(state.base)
        covariance = state.belief.covariance[:count, :count]
        mean = state.belief.mean[:count]
        pose = space.dof(mean)
        step = 1e-5
        shifted = torch.cat((mean[None], mean + step * torch.eye(count, dtype=mean.dtype)))
        keypoints = self.kinematics(space.dof(shifted), shape, root_reference=state.reference).keypoints
        jacobian = (keypoints[1:] - keypoints[0]).permute(1, 2, 0) / step  # 21 3 free
        rotation = rotation_from_vector(pose[3:6]) @ state.reference
        absolute = torch.cat((pose[:3], vector_from_rotation(rotation), pose[6:]))
        spread = (space.basis @ covariance @ space.basis.T).diagonal().clamp_min(0).sqrt()
        return Estimate(
            status=status,
            pose=absolute,
            pose_std=spread,
            root_rotation=rotation,
            keypoints=keypoints[0],
            keypoints_px=self.camera.project(keypoints[0]),
            keypoints_cov=jacobian @ covariance @ jacobian.mT + self._model_covariance(keypoints[0]),
            overlap=overlap_,
            found=found,
            nis=nis,
        )

    def _model_covariance(self, keypoints: Float[Tensor, "21 3"]) -> Float[Tensor, "21 3 3"]:
        """What the filter cannot know: joint centres within the flesh, and scale where the hand's length is not measured."""
        eye = torch.eye(3, dtype=keypoints.dtype)
        outer = keypoints[:, :, None] * keypoints[:, None, :]
        scale_std = 0.0
        if self.known_shape is None and self.camera.kind == "pinhole":
            space = self.kinematics.shape_space
            index = space.names.index("hand_length")
            scale_std = float(space.std[index] / space.default[index])
        return _JOINT_CENTRE_STD**2 * eye + scale_std**2 * outer

    # ------------------------------------------------------------------ saving

    def state_dict(self, state: TrackerState | None, memory: Memory) -> dict[str, Any]:
        """Plain tensors and numbers from which `restore` goes on exactly."""
        saved: dict[str, Any] = {"shape": memory.shape, "posture": memory.posture}
        saved["frames_since_search"] = memory.frames_since_search
        saved["colours"] = None if memory.appearance is None else memory.appearance.colours.log_ratio
        if state is not None:
            saved |= {"mean": state.belief.mean, "covariance": state.belief.covariance, "base": state.base}
            saved |= {"reference": state.reference, "start_reference": state.start_reference, "failures": state.failures}
        return saved

    def restore(self, saved: dict[str, Any]) -> tuple[TrackerState | None, Memory]:
        """The inverse of `state_dict`."""
        colours = saved["colours"]
        appearance = None if colours is None else Appearance(colours=ColourModel(log_ratio=colours))
        memory = Memory(
            shape=saved["shape"],
            posture=saved["posture"],
            appearance=appearance,
            frames_since_search=saved["frames_since_search"],
        )
        if "mean" not in saved:
            return None, memory
        state = TrackerState(
            belief=Gaussian(saved["mean"], saved["covariance"]),
            base=saved["base"],
            reference=saved["reference"],
            start_reference=saved["start_reference"],
            failures=saved["failures"],
        )
        return state, memory


_SETTLING = 4  # measurement updates on the starting picture

_JOINT_CENTRE_STD = 0.004
"""Metres: two hand models place their joint centres a few millimetres apart under the same skin."""


def _kind(name: str) -> str:
    if name.startswith("root_t"):
        return "translation"
    return "rotation" if name.startswith("root_r") else "angle"


def _prior_rows(space: PoseSpace, settings: ContourTrackerSettings) -> tuple[Tensor, Tensor, list[tuple[int, int]]]:
    """Rows of the weak beliefs: matrix over the free parameters, variances, and (row, axis) of those about the tilt."""
    p = settings.prior
    rows: list[Tensor] = []
    variances: list[float] = []
    tilts: list[tuple[int, int]] = []
    names = space.free_names
    for i, name in enumerate(names):
        row = torch.zeros(len(names), dtype=torch.float64)
        row[i] = 1.0
        if name in ("root_rx", "root_ry"):
            tilts.append((len(rows), DOFS.index(name) - 3))
            std = p.tilt_std_rad
        elif name.startswith("root_"):
            continue
        elif name.endswith("_dip_fe") and name.replace("dip", "pip") in names:
            row[names.index(name.replace("dip", "pip"))] = -2.0 / 3.0
            std = p.tie_std_rad
        elif name.endswith(("_aa", "_tw")):
            std = p.side_std_rad
        else:
            std = p.rest_std_rad
        rows.append(row)
        variances.append(std**2)
    matrix = torch.stack(rows) if rows else torch.zeros(0, len(names), dtype=torch.float64)
    return matrix, torch.tensor(variances, dtype=torch.float64), tilts


