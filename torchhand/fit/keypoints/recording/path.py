"""The poses of a recording as one path, which is smoothed forwards and backwards (Rauch, Tung and Striebel 1965)."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.fit.keypoints.recording.motion import Motion, motion_of
from torchhand.geometry import rotation_from_vector, vector_from_rotation
from torchhand.hand import HandPose, PoseSpace, Skeleton
from torchhand.hand.limits import clamp_to_limits

_FREEDOM = 4.0  # degrees of freedom of the t distribution of a frame's innovation, for each number
_AROUND = 3  # frames on each side of one that tell what is usual there
_LEAP_STD = 2.0  # standard deviations from that
_ROTATION = slice(3, 6)


@dataclass(frozen=True, kw_only=True)
class Smoothed:
    """Poses of all frames by those before and after them."""

    pose: HandPose
    """Poses (frames) with zero rotation vectors, within the limits."""
    covariance: Float[Tensor, "frames free free"]
    """Covariance of the free parameters, the rotation a left perturbation."""


@dataclass(frozen=True, kw_only=True)
class PosePath:
    """Poses of a recording's frames, at equal distances in time, in a pose space that begins with the root's six."""

    values: Float[Tensor, "frames free"]
    """Free parameters; in the place of the rotation the turns from frame to frame, added up."""
    reference: Float[Tensor, "frames 3 3"]
    """Rotations."""
    covariance: Float[Tensor, "frames free free"]
    is_known: Bool[Tensor, "frames"]
    """Frames that have a pose; others hold that of the frame before, or the first one."""
    space: PoseSpace

    @classmethod
    def of(
        cls,
        pose: HandPose,
        covariance: Float[Tensor, "frames free free"],
        is_known: Bool[Tensor, "frames"],
        space: PoseSpace,
    ) -> "PosePath":
        """pose: anything where it is not known. Raises ValueError where none is."""
        if not bool(is_known.any()):
            raise ValueError("is_known: expected a frame with a pose, got none")
        count = len(is_known)
        known = torch.where(is_known, torch.arange(count, device=is_known.device), -1).cummax(0).values
        known = torch.where(known < 0, int(is_known.nonzero()[0, 0]), known)
        own = pose[known].normalized()
        values = space.free(own.dofs)
        turns = vector_from_rotation(own.reference[1:] @ own.reference[:-1].mT)
        values[:, _ROTATION] = torch.nn.functional.pad(turns.cumsum(0), (0, 0, 1, 0))
        return cls(values=values, reference=own.reference, covariance=covariance[known], is_known=is_known, space=space)

    def leaps(self) -> Bool[Tensor, "frames"]:
        """Frames with an angle that is far from its median over the frames around, which follows any steady motion."""
        known = self.is_known.nonzero()[:, 0]
        joints = self.values[known, _ROTATION.stop :]
        padded = torch.cat((joints[:1].expand(_AROUND, -1), joints, joints[-1:].expand(_AROUND, -1)))
        away = (joints - padded.unfold(0, 2 * _AROUND + 1, 1).median(-1).values).abs()
        std = self.covariance[known].diagonal(dim1=-2, dim2=-1)[:, _ROTATION.stop :].sqrt()
        leaps = torch.zeros_like(self.is_known)
        leaps[known] = (away > _LEAP_STD * std).any(-1)
        return leaps

    def without(self, frames: Bool[Tensor, "frames"]) -> "PosePath":
        """The path by other frames alone; itself where there would be none."""
        left = self.is_known & ~frames
        if not bool(left.any()):
            return self
        pose = HandPose(dofs=self._dofs(self.values), reference=self.reference)
        return PosePath.of(pose, self.covariance, left, self.space)

    def motion(self) -> Motion:
        """How the hand moves, by the path itself."""
        return motion_of(self.values, self.covariance.diagonal(dim1=-2, dim2=-1), self.is_known)

    def smoothed(self, motion: Motion, skeleton: Skeleton) -> Smoothed:
        """All frames; those without a pose by their neighbours alone."""
        fresh = motion.fresh.sqrt()
        noise = self.covariance * fresh[:, None] * fresh
        values, spread = _smoothed(self.values, noise, self.is_known, motion.acceleration)
        lasting = (1 - motion.fresh).clamp_min(0.0).sqrt()
        reference = rotation_from_vector(values[:, _ROTATION] - self.values[:, _ROTATION]) @ self.reference
        return Smoothed(
            pose=HandPose(dofs=clamp_to_limits(self._dofs(values), skeleton), reference=reference),
            covariance=spread + self.covariance * lasting[:, None] * lasting,
        )

    def _dofs(self, values: Float[Tensor, "frames free"]) -> Float[Tensor, "frames 36"]:
        """All DOFs, without the rotation."""
        dofs = self.space.dof(values)
        dofs[:, _ROTATION] = 0
        return dofs


def _smoothed(
    values: Float[Tensor, "frames free"],
    noise: Float[Tensor, "frames free free"],
    is_known: Bool[Tensor, "frames"],
    acceleration: Float[Tensor, "free"],
) -> tuple[Float[Tensor, "frames free"], Float[Tensor, "frames free free"]]:
    """Means and covariances of a path with constant velocity but for white accelerations."""
    free = values.shape[1]
    eye, q = torch.eye(free).to(values), acceleration.diag()
    step = torch.cat((torch.cat((eye, eye), 1), torch.cat((0 * eye, eye), 1)))
    process = torch.cat((torch.cat((q / 3, q / 2), 1), torch.cat((q / 2, q), 1)))
    first = int(is_known.nonzero()[0, 0])
    mean = torch.cat((values[first], torch.zeros_like(values[first])))
    spread = torch.block_diag(noise[first], 10 * q + noise[first])
    predicted, filtered = [(mean, spread)], [(mean, spread)]
    for row in range(len(values)):
        if row:
            mean, spread = step @ mean, step @ spread @ step.T + process
            predicted.append((mean, spread))
            if bool(is_known[row]) and row != first:
                missed, inner = values[row] - mean[:free], spread[:free, :free] + noise[row]
                away = float(missed @ torch.linalg.solve(inner, missed))
                gross = max(0.0, (_FREEDOM * free + away) / ((_FREEDOM + 1) * free) - 1)
                inner = inner + gross * noise[row]
                gain = torch.linalg.solve(inner, spread[:free]).T
                mean, spread = mean + gain @ missed, spread - gain @ spread[:free]
                spread = 0.5 * (spread + spread.T)
            filtered.append((mean, spread))
    means, spreads = [filtered[-1][0][:free]], [filtered[-1][1][:free, :free]]
    mean, spread = filtered[-1]
    for row in range(len(values) - 2, -1, -1):
        own_mean, own = filtered[row]
        next_mean, next_spread = predicted[row + 1]
        back = torch.linalg.solve(next_spread, step @ own).T
        mean, spread = own_mean + back @ (mean - next_mean), own + back @ (spread - next_spread) @ back.T
        spread = 0.5 * (spread + spread.T)
        means.append(mean[:free])
        spreads.append(spread[:free, :free])
    return torch.stack(means[::-1]), torch.stack(spreads[::-1])


def is_short_gap(is_known: Bool[Tensor, "frames"], longest: int) -> Bool[Tensor, "frames"]:
    """Frames of runs without a pose, at most so long, between frames that have one."""
    rows = torch.arange(len(is_known), device=is_known.device)
    before = torch.where(is_known, rows, -1).cummax(0).values
    after = torch.where(is_known, rows, len(rows)).flip(0).cummin(0).values.flip(0)
    return ~is_known & (before >= 0) & (after < len(rows)) & (after - before - 1 <= longest)
