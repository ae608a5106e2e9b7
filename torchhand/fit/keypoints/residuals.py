"""Distances of a hand's keypoints from measured ones, in units of their noise, and the derivatives."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.fit.keypoints.prior import NaturalPosture
from torchhand.geometry import Camera, batch_last
from torchhand.hand import KEYPOINT_BONES, HandFrames, HandKinematics, PoseJacobian, PoseSpace, ShapeJacobian
from torchhand.numerics import NormalEquations, RobustLoss

_NEAREST = 0.01  # metres from the camera: a hand nearer than this is no solution


@dataclass(frozen=True, kw_only=True)
class Observations:
    """Measured keypoints, one row per frame."""

    points: Float[Tensor, "frames 21 d"]
    """Metres in the world, or px; any finite number where the confidence is 0."""
    confidence: Float[Tensor, "frames 21"]
    """0 for missing points."""
    noise: Float[Tensor, "frames"]
    """Standard deviation of a point of confidence 1 along each axis, metres or px."""
    coarse_noise: Float[Tensor, "frames"]
    """The same for telling starts apart: not so small that only the nearest of them can be followed."""
    camera: Camera | None
    """Of the pixels: one for all frames or one per frame; None in space."""

    @property
    def is_known(self) -> Bool[Tensor, "frames 21"]:
        return self.confidence > 0

    @property
    def weight(self) -> Float[Tensor, "frames 21"]:
        return self.confidence / self.noise[:, None].square()

    def coarse(self) -> "Observations":
        """The same points, trusted less."""
        return replace(self, noise=self.coarse_noise)

    def rows(self, rows: Int[Tensor, "k"]) -> "Observations":
        camera = self.camera
        if camera is not None and camera.intrinsics.ndim > 2:
            names = ("intrinsics", "rotation", "translation", "distortion")
            camera = replace(camera, **{name: getattr(camera, name)[rows] for name in names})
        return Observations(
            points=self.points[rows],
            confidence=self.confidence[rows],
            noise=self.noise[rows],
            coarse_noise=self.coarse_noise[rows],
            camera=camera,
        )


@dataclass(frozen=True, kw_only=True)
class Common:
    """What all frames share."""

    shape: Float[Tensor, "shape"]
    log_scale: Float[Tensor, ""]
    """Logarithm of the metres per unit of the measured points in space."""
    offsets: Float[Tensor, "21 3"]
    """The maker's keypoints less ours, in the frame of the bone that carries the keypoint, metres."""


@dataclass(frozen=True, kw_only=True)
class Blocks:
    """Normal equations of poses and common parameters together: an arrow."""

    pose: Float[Tensor, "frames n n"]
    mixed: Float[Tensor, "frames n k"]
    common: Float[Tensor, "k k"]
    pose_gradient: Float[Tensor, "frames n"]
    common_gradient: Float[Tensor, "k"]
    cost: Float[Tensor, ""]


@dataclass(frozen=True, kw_only=True)
class KeypointCost:
    """½ Σ ρ(|keypoint - measured|² / noise²) + ½ |posture - natural|², frame by frame."""

    kinematics: HandKinematics
    space: PoseSpace
    observed: Observations
    reference: Float[Tensor, "frames 3 3"]
    """world_from_hand that the root's rotation vector is applied to."""
    prior: NaturalPosture
    prior_share: Float[Tensor, "frames 36"]
    """0 to 1: how far the belief in the natural posture holds for each DOF of each frame."""
    robust: RobustLoss
    pose_jacobian: PoseJacobian
    shape_jacobian: ShapeJacobian
    has_scale: bool
    has_offsets: bool
    chunk: int

    def rows(self, rows: Int[Tensor, "k"]) -> "KeypointCost":
        """Of the given frames."""
        return replace(
            self,
            observed=self.observed.rows(rows),
            reference=self.reference[rows],
            prior_share=self.prior_share[rows],
        )

    def frames(self, free: Tensor, rows: Tensor, common: Common) -> tuple[Float[Tensor, "k 36"], HandFrames]:
        pose = self.space.dof(free)
        return pose, self.kinematics(pose, common.shape, root_reference=self.reference[rows])

    def pose_equations(self, free: Tensor, rows: Tensor, common: Common) -> NormalEquations:
        """Of every frame by itself, the common parameters held."""
        parts = [self._pose_chunk(*part, common) for part in self._chunks(free, rows)]
        matrix, gradient, cost = (torch.cat([part[i] for part in parts]) for i in range(3))
        return NormalEquations(matrix=matrix, gradient=gradient, cost=cost)

    def blocks(self, free: Tensor, rows: Tensor, common: Common) -> Blocks:
        """Of poses and common parameters; the prior of the common ones is not in it."""
        pose, mixed, gradients, cost = [], [], [], free.new_zeros(())
        shared: Tensor | None = None
        shared_gradient: Tensor | None = None
        for part_free, part_rows in self._chunks(free, rows):
            residual, jacobian, in_common, part_cost = self._whitened(part_free, part_rows, common, with_common=True)
            of_prior, prior_gradient, prior_cost = self._prior(part_free, part_rows)
            assert in_common is not None
            pose.append(jacobian.mT @ jacobian + of_prior)
            mixed.append(jacobian.mT @ in_common)
            gradients.append((jacobian.mT @ residual[..., None]).squeeze(-1) + prior_gradient)
            flat = in_common.flatten(0, 1)
            part_shared, part_gradient = flat.mT @ flat, flat.mT @ residual.flatten()
            shared = part_shared if shared is None else shared + part_shared
            shared_gradient = part_gradient if shared_gradient is None else shared_gradient + part_gradient
            cost = cost + (part_cost + prior_cost).sum()
        assert shared is not None
        assert shared_gradient is not None
        return Blocks(
            pose=torch.cat(pose),
            mixed=torch.cat(mixed),
            common=shared,
            pose_gradient=torch.cat(gradients),
            common_gradient=shared_gradient,
            cost=cost,
        )

    def distances(
        self, free: Tensor, rows: Tensor, common: Common
    ) -> tuple[Float[Tensor, "k 36"], HandFrames, Float[Tensor, "k 21"]]:
        """Pose, frames, and distance of each point from its measurement: metres, or px. Missing points have NaN."""
        pose, frames = self.frames(free, rows, common)
        difference, _ = self._difference(self._points(frames, common), rows, common)
        distance = difference.norm(dim=-1)
        return pose, frames, torch.where(self.observed.is_known[rows], distance, torch.nan)

    def _chunks(self, free: Tensor, rows: Tensor) -> list[tuple[Tensor, Tensor]]:
        return list(zip(free.split(self.chunk), rows.split(self.chunk), strict=True))

    def _pose_chunk(self, free: Tensor, rows: Tensor, common: Common) -> tuple[Tensor, Tensor, Tensor]:
        residual, jacobian, _, cost = self._whitened(free, rows, common, with_common=False)
        of_prior, prior_gradient, prior_cost = self._prior(free, rows)
        gradient = (jacobian.mT @ residual[..., None]).squeeze(-1)
        return jacobian.mT @ jacobian + of_prior, gradient + prior_gradient, cost + prior_cost

    def _points(self, frames: HandFrames, common: Common) -> Float[Tensor, "k 21 3"]:
        """Keypoints as their maker defines them."""
        if not self.has_offsets:
            return frames.keypoints
        bones = frames.rotation[:, list(KEYPOINT_BONES)]
        return frames.keypoints + (bones @ self._sided(common.offsets)[..., None]).squeeze(-1)

    def _difference(self, points: Tensor, rows: Tensor, common: Common) -> tuple[Tensor, Tensor | None]:
        """Model less measurement (k, 21, d), and the derivative of the picture's points with those of space."""
        observed = self.observed.rows(rows)
        if observed.camera is None:
            return points - common.log_scale.exp() * observed.points, None
        camera = observed.camera
        in_camera = camera.cam_from_world(points)
        plane = camera.plane_from_cam(in_camera)
        if camera.kind == "pinhole":
            inverse = 1 / in_camera[..., 2]
            is_before = in_camera[..., 2] > _NEAREST
            plane = torch.where(is_before[..., None], plane, torch.nan)
            of_plane = torch.zeros(*plane.shape, 3, dtype=plane.dtype, device=plane.device)
            of_plane[..., 0, 0] = of_plane[..., 1, 1] = inverse
            of_plane[..., 2] = -plane * inverse[..., None]
        else:
            of_plane = torch.eye(3, dtype=plane.dtype, device=plane.device)[:2].expand(*plane.shape, 3)
        turned = of_plane @ (camera.rotation if camera.rotation.ndim == 2 else camera.rotation[:, None])
        return camera.pixels_from_plane(plane) - observed.points, camera.pixel_jacobian(plane) @ turned

    def _sided(self, offsets: Tensor) -> Tensor:
        """Offsets of a right hand's bones as those of this hand."""
        return offsets if self.kinematics.side == "right" else offsets * offsets.new_tensor((1.0, 1.0, -1.0))

    def _whitened(
        self, free: Tensor, rows: Tensor, common: Common, *, with_common: bool
    ) -> tuple[Tensor, Tensor, Tensor | None, Tensor]:
        """Residuals (k, m), their Jacobians (k, m, n) and (k, m, c), all times the root of their weights; costs."""
        pose, frames = self.frames(free, rows, common)
        points = self._points(frames, common)
        difference, in_picture = self._difference(points, rows, common)
        weight = self.observed.weight[rows]
        dimension = difference.shape[-1]
        whitened = torch.where(weight[..., None] > 0, difference * weight.sqrt()[..., None], 0.0)
        cost, gross = self.robust.cost_and_weights(whitened.flatten(1))
        root = gross.sqrt()
        factor = root.unflatten(1, (-1, dimension))[..., 0] * weight.sqrt()
        batch = pose.shape[:1]
        rotation = batch_last(frames.rotation, 3, batch)
        position, keypoints = batch_last(frames.position, 2, batch), batch_last(points, 2, batch)
        columns = self.pose_jacobian.batch_last(pose.T, rotation, position, keypoints)
        jacobian = self._in_measurements(columns, in_picture, factor)
        in_common = None
        if with_common:
            parts = [self.shape_jacobian.batch_last(rotation, common.shape[:, None])]
            if self.has_scale:
                scaled = -common.log_scale.exp() * self.observed.points[rows]
                parts.append(scaled.permute(1, 2, 0)[:, :, None])
            if self.has_offsets:
                parts.append(self._offset_columns(rotation))
            in_common = self._in_measurements(torch.cat(parts, 2), in_picture, factor)
        return root * whitened.flatten(1), jacobian, in_common, cost

    def _in_measurements(self, columns: Tensor, in_picture: Tensor | None, factor: Tensor) -> Tensor:
        """(21, 3, n, k) derivatives of the points in space as (k, 21 d, n) derivatives of the weighted residuals."""
        if in_picture is None:
            scaled = columns * factor.T[:, None, None]
        else:
            known = torch.where(factor[..., None, None] > 0, in_picture * factor[..., None, None], 0.0)
            x, y, z = known.permute(1, 2, 3, 0)[..., None, :].unbind(2)
            scaled = x * columns[:, None, 0] + y * columns[:, None, 1] + z * columns[:, None, 2]
        return scaled.permute(3, 0, 1, 2).flatten(1, 2).contiguous()  # products of strided matrices are slow

    def _offset_columns(self, rotation: Tensor) -> Tensor:
        """Derivative of the points with the offsets: the bones' rotations, block by block."""
        bones = rotation[list(KEYPOINT_BONES)] * self._sided(rotation.new_ones(3))[None, None, :, None]
        out = rotation.new_zeros(21, 3, 21, 3, rotation.shape[-1])
        each = torch.arange(21, device=rotation.device)
        out[each, :, each] = bones
        return out.flatten(2, 3)

    def _prior(self, free: Tensor, rows: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        share = self.prior_share[rows]
        if self.prior.is_empty or not bool(share.any()):
            zero = torch.zeros((), dtype=free.dtype, device=free.device)
            return zero, zero, zero
        root = share.sqrt()
        basis = root[..., None] * self.space.basis
        away = root * (self.space.dof(free) - self.prior.mean)
        pull = away @ self.prior.precision
        matrix = basis.mT @ (self.prior.precision @ basis)
        gradient = (basis.mT @ pull[..., None]).squeeze(-1)
        return matrix, gradient, 0.5 * (pull * away).sum(-1)
