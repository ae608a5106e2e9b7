"""Reprojection of a board's corners, with its derivatives in lens, camera pose and board pose; averages of poses."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.geometry import distort, distortion_jacobian, skew, vector_from_rotation


@dataclass(frozen=True, kw_only=True)
class Pose:
    """Rigid transforms: destination = rotation source + translation."""

    rotation: Float[Tensor, "*batch 3 3"]
    translation: Float[Tensor, "*batch 3"]

    def __matmul__(self, other: "Pose") -> "Pose":
        return Pose(
            rotation=self.rotation @ other.rotation,
            translation=(self.rotation @ other.translation[..., None]).squeeze(-1) + self.translation,
        )

    def __getitem__(self, rows: Tensor | int) -> "Pose":
        return Pose(rotation=self.rotation[rows], translation=self.translation[rows])

    def inverse(self) -> "Pose":
        back = self.rotation.mT
        return Pose(rotation=back, translation=-(back @ self.translation[..., None]).squeeze(-1))

    @staticmethod
    def identity() -> "Pose":
        return Pose(rotation=torch.eye(3, dtype=torch.float64), translation=torch.zeros(3, dtype=torch.float64))

    @staticmethod
    def stacked(poses: "list[Pose]") -> "Pose":
        return Pose(
            rotation=torch.stack([pose.rotation for pose in poses]),
            translation=torch.stack([pose.translation for pose in poses]),
        )


@dataclass(frozen=True, kw_only=True)
class Reprojection:
    """Pixels of points, and their derivatives. Rotations change on the left: exp(w) R."""

    points_px: Float[Tensor, "points 2"]
    by_lens: Float[Tensor, "points 2 lens"]
    by_camera: Float[Tensor, "points 2 6"]
    """Derivative in w and the translation of cam_from_world."""
    by_board: Float[Tensor, "points 2 6"]
    """Derivative in w and the translation of world_from_board."""


def reproject(
    lens: Float[Tensor, "lens"],
    cam_from_world: Pose,
    world_from_board: Pose,
    points_board: Float[Tensor, "points 3"],
) -> Reprojection:
    """Where a camera sees points of a board that has its own pose for every point.

    lens: fx, fy, cx, cy, then 0, 4, 5 or 8 distortion coefficients in OpenCV's order; no skew. Points behind the camera
    give mirrored pixels.
    """
    turned = (world_from_board.rotation @ points_board[..., None]).squeeze(-1)
    points_world = turned + world_from_board.translation
    rotated = points_world @ cam_from_world.rotation.T
    points_cam = rotated + cam_from_world.translation
    depth = points_cam[:, 2:]
    plane = points_cam[:, :2] / depth
    focal, centre, coefficients = lens[:2], lens[2:4], lens[4:]
    distorted = distort(plane, coefficients) if len(coefficients) else plane
    by_plane = distortion_jacobian(plane, coefficients) if len(coefficients) else torch.eye(2, dtype=lens.dtype)
    one = torch.eye(2, dtype=lens.dtype).expand(len(plane), 2, 2)
    plane_by_point = torch.cat((one, -plane[..., None]), -1) / depth[..., None]
    by_point = focal[:, None] * (by_plane @ plane_by_point)
    by_lens = torch.cat(
        (torch.diag_embed(distorted), one, focal[:, None] * coefficient_jacobian(plane, coefficients)), -1
    )
    by_world = by_point @ cam_from_world.rotation
    return Reprojection(
        points_px=focal * distorted + centre,
        by_lens=by_lens,
        by_camera=torch.cat((-by_point @ skew(rotated), by_point), -1),
        by_board=torch.cat((-by_world @ skew(turned), by_world), -1),
    )


def coefficient_jacobian(
    plane: Float[Tensor, "*points 2"], coefficients: Float[Tensor, "k"]
) -> Float[Tensor, "*points 2 k"]:
    """Derivative of `distort` with its coefficients k1 k2 p1 p2 k3 k4 k5 k6, as many as there are (at most 8)."""
    count = len(coefficients)
    if count > 8:
        raise ValueError(f"coefficients: expected at most 8, got {count}")
    if not count:
        return plane.new_zeros(*plane.shape, 0)
    k = [*coefficients, *[coefficients.new_zeros(())] * (8 - count)]
    x, y = plane.unbind(-1)
    r2 = x * x + y * y
    powers = torch.stack((r2, r2**2, r2**3), -1)
    above = 1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    below = 1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
    up = plane[..., :, None] * (powers / below[..., None])[..., None, :]
    down = -plane[..., :, None] * (powers * (above / below**2)[..., None])[..., None, :]
    first = torch.stack((2 * x * y, r2 + 2 * y * y), -1)[..., None]
    second = torch.stack((r2 + 2 * x * x, 2 * x * y), -1)[..., None]
    return torch.cat((up[..., :2], first, second, up[..., 2:], down), -1)[..., :count]


def central_pose(poses: Pose, *, length: float) -> int:
    """The one of several poses that is nearest to all others: an average that outliers do not move.

    length: metres that count as much as a radian.
    """
    relative = poses.rotation[:, None] @ poses.rotation[None].mT
    angles = vector_from_rotation(relative).norm(dim=-1)
    distances = torch.cdist(poses.translation, poses.translation)
    return int((angles + distances / length).sum(-1).argmin())
