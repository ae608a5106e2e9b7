"""Bundle adjustment: lenses, cameras and boards that together minimise the reprojection error."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.calibration.board import Board
from torchhand.calibration.camera import CameraViews, FrameIndex
from torchhand.calibration.reprojection import Pose, Reprojection, reproject
from torchhand.geometry import left_jacobian, rotation_from_vector
from torchhand.numerics import LevenbergMarquardtSettings, NormalEquations, levenberg_marquardt

_SETTINGS = LevenbergMarquardtSettings(iterations=60, cost_tolerance=1e-10)


@dataclass(frozen=True, kw_only=True)
class Bundle:
    """Everything that a set of pictures of one board determines; the first camera is the world."""

    views: tuple[CameraViews, ...]
    board: Board
    lenses: tuple[Float[Tensor, "_lens"], ...]
    cam_from_world: Pose
    """Poses of the cameras, (cameras,)."""
    world_from_board: Pose
    """Poses of the board, (frames,)."""
    frames: tuple[FrameIndex, ...]

    def of(self, views: Sequence[CameraViews]) -> "Bundle":
        """The same values for fewer pictures."""
        left = sorted({frame for view in views for frame in view.corners})
        rows = torch.tensor([self.frames.index(frame) for frame in left])
        return replace(self, views=tuple(views), world_from_board=self.world_from_board[rows], frames=tuple(left))

    def residuals(self) -> dict[tuple[int, FrameIndex], Float[Tensor, "_found 2"]]:
        """Seen minus computed pixels, by place of the camera and frame."""
        residuals = {}
        for c, found in enumerate(self._observations):
            difference = found.points_px - self._reproject(c).points_px
            for frame, part in zip(found.frames, difference.split(found.counts), strict=True):
                residuals[c, self.frames[frame]] = part
        return residuals

    def standard_deviations(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Standard deviations of each camera's fx, relative, and of its translation (largest of three; metres), from
        the residuals."""
        found = self.normal_equations(torch.zeros(self._size, dtype=torch.float64))
        count = 2 * sum(len(seen.points_px) for seen in self._observations)
        variance = 2 * float(found.cost) / max(1, count - self._size)
        scale = found.matrix.diagonal().clamp_min(1e-300).rsqrt()
        scaled = scale[:, None] * found.matrix * scale
        spread = variance * torch.linalg.pinv(scaled, hermitian=True).diagonal() * scale.square()
        std = spread.clamp_min(0).sqrt()
        focal = tuple(
            float(std[columns[0]] / lens[0]) for columns, lens in zip(self._lens_at, self.lenses, strict=True)
        )
        centre = tuple(float(std[at[3:]].max()) if len(at) else 0.0 for at in self._camera_at)
        return focal, centre

    def moved(self, values: Float[Tensor, "n"]) -> "Bundle":
        """Lenses changed by their part of the values, poses turned by theirs on the left and shifted."""
        lenses = tuple(lens + values[at] for lens, at in zip(self.lenses, self._lens_at, strict=True))
        cameras = torch.zeros(len(self.views), 6, dtype=torch.float64)
        for i, at in enumerate(self._camera_at):
            if len(at):
                cameras[i] = values[at]
        return replace(
            self,
            lenses=lenses,
            cam_from_world=_moved(self.cam_from_world, cameras),
            world_from_board=_moved(self.world_from_board, values[self._board_at]),
        )

    def normal_equations(self, values: Float[Tensor, "n"]) -> NormalEquations:
        """Normal equations at `values` (see `moved`), block by block: a corner depends on one lens, one camera and one
        board only."""
        at = self.moved(values)
        matrix = torch.zeros(self._size, self._size, dtype=torch.float64)
        gradient = torch.zeros(self._size, dtype=torch.float64)
        cost = torch.zeros((), dtype=torch.float64)
        board_turn = left_jacobian(values[self._board_at][:, :3])
        for c, found in enumerate(self._observations):
            seen = at._reproject(c)
            by_board = _by_vector(seen.by_board, board_turn[found.moment_of])
            parts, columns = [seen.by_lens], [self._lens_at[c]]
            if len(self._camera_at[c]):
                turn = left_jacobian(values[self._camera_at[c]][:3])
                parts.append(_by_vector(seen.by_camera, turn.expand(len(by_board), 3, 3)))
                columns.append(self._camera_at[c])
            jacobian = torch.cat((*parts, by_board), -1)
            residual = seen.points_px - found.points_px
            cost = cost + 0.5 * residual.square().sum()
            blocks = zip(found.frames, jacobian.split(found.counts), residual.split(found.counts), strict=True)
            for frame, block, rest in blocks:
                block, rest = block.flatten(0, 1), rest.flatten()
                places = torch.cat((*columns, self._board_at[frame]))
                matrix.index_put_((places[:, None], places[None]), block.T @ block, accumulate=True)
                gradient.index_put_((places,), block.T @ rest, accumulate=True)
        return NormalEquations(matrix=matrix, gradient=gradient, cost=cost)

    def _reproject(self, camera: int) -> Reprojection:
        found = self._observations[camera]
        return reproject(
            self.lenses[camera],
            self.cam_from_world[camera],
            self.world_from_board[found.moment_of],
            found.points_board,
        )

    @cached_property
    def _observations(self) -> list["_Observations"]:
        points = self.board.points()
        return [_Observations.of(view, self.frames, points) for view in self.views]

    # Where the values of each lens, camera and board stand in the vector of all.

    @cached_property
    def _lens_at(self) -> list[Tensor]:
        return list(_ranges([len(lens) for lens in self.lenses], 0))

    @cached_property
    def _camera_at(self) -> list[Tensor]:
        start = sum(len(lens) for lens in self.lenses)
        return list(_ranges([0] + [6] * (len(self.views) - 1), start))

    @cached_property
    def _board_at(self) -> Tensor:
        start = sum(len(lens) for lens in self.lenses) + 6 * (len(self.views) - 1)
        return torch.arange(start, start + 6 * len(self.frames)).reshape(-1, 6)

    @property
    def _size(self) -> int:
        return int(self._board_at[-1, -1]) + 1


def adjust(bundle: Bundle) -> Bundle:
    """The bundle with least reprojection error."""
    start = torch.zeros(bundle._size, dtype=torch.float64)
    found = levenberg_marquardt(bundle.normal_equations, start, settings=_SETTINGS)
    return bundle.moved(found.values)


@dataclass(frozen=True, kw_only=True)
class _Observations:
    """All corners that one camera saw, frame by frame."""

    points_px: Tensor
    points_board: Tensor
    moment_of: Tensor
    """Row of each corner's frame in the bundle."""
    frames: list[int]
    """The rows, in order."""
    counts: list[int]
    """Corners of each."""

    @classmethod
    def of(cls, view: CameraViews, frames: Sequence[FrameIndex], points: Tensor) -> "_Observations":
        rows = {frame: row for row, frame in enumerate(frames)}
        order = sorted(view.corners)
        counts = [len(view.corners[frame].ids) for frame in order]
        seen = torch.tensor([rows[frame] for frame in order])
        return cls(
            points_px=torch.cat([view.corners[frame].points_px for frame in order]),
            points_board=points[torch.cat([view.corners[frame].ids for frame in order])],
            moment_of=seen.repeat_interleave(torch.tensor(counts)),
            frames=seen.tolist(),
            counts=counts,
        )


def _ranges(lengths: Sequence[int], start: int) -> Iterator[Tensor]:
    for length in lengths:
        yield torch.arange(start, start + length)
        start += length


def _moved(pose: Pose, values: Tensor) -> Pose:
    return Pose(
        rotation=rotation_from_vector(values[..., :3]) @ pose.rotation, translation=pose.translation + values[..., 3:]
    )


def _by_vector(by_pose: Tensor, turn: Tensor) -> Tensor:
    """Derivative with a rotation vector instead of a small turn after it."""
    return torch.cat((by_pose[..., :3] @ turn, by_pose[..., 3:]), -1)
