"""One camera's lens from pictures of a board, and where the board was in each."""

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.calibration.board import Board, BoardCorners
from torchhand.calibration.reprojection import Pose

FrameIndex = int
"""Index of a frame: pictures of one frame show the board in one place, whichever camera took them."""

DISTORTIONS = (0, 4, 5, 8)
_CELLS = 4  # per side of the picture, for its coverage


@dataclass(frozen=True, kw_only=True)
class CameraViews:
    """What one camera saw of the board."""

    name: str
    width: int
    height: int
    corners: Mapping[FrameIndex, BoardCorners]

    def without(self, frames: set[FrameIndex]) -> "CameraViews":
        kept = {frame: found for frame, found in self.corners.items() if frame not in frames}
        return CameraViews(name=self.name, width=self.width, height=self.height, corners=kept)

    @property
    def coverage(self) -> float:
        """Share of the cells of a 4 x 4 grid over the picture in which a corner was seen."""
        if not self.corners:
            return 0.0
        points = torch.cat([found.points_px for found in self.corners.values()])
        size = torch.tensor((self.width, self.height), dtype=points.dtype)
        cells = ((points + 0.5) / size * _CELLS).long().clamp(0, _CELLS - 1)
        return len((cells[:, 0] * _CELLS + cells[:, 1]).unique()) / _CELLS**2


@dataclass(frozen=True, kw_only=True)
class SingleCalibration:
    """Calibration of one camera by itself."""

    lens: Float[Tensor, "lens"]
    """fx, fy, cx, cy, then the distortion."""
    cam_from_board: dict[FrameIndex, Pose]
    residual_px: dict[FrameIndex, float]
    """Root mean square over the corners of one picture."""

    @property
    def rms_px(self) -> float:
        values = torch.tensor(list(self.residual_px.values()), dtype=torch.float64)
        return float(values.square().mean().sqrt())

    @property
    def tilt_deg(self) -> float:
        """Largest angle between the board's normals in the camera's frame."""
        normals = torch.stack([pose.rotation[:, 2] for pose in self.cam_from_board.values()])
        return float((normals @ normals.T).min().clamp(-1, 1).acos().rad2deg())


def calibrate_camera(views: CameraViews, board: Board, *, distortion: int = 5) -> SingleCalibration:
    """Zhang's method (OpenCV): lens and board poses with least reprojection error.

    distortion: number of coefficients, 0, 4 (k1 k2 p1 p2), 5 (and k3) or 8 (and k4 k5 k6).

    Raises ValueError where there are fewer than three pictures, and cv2.error where OpenCV finds no solution.
    """
    if distortion not in DISTORTIONS:
        raise ValueError(f"distortion: expected one of {DISTORTIONS}, got {distortion}")
    if len(views.corners) < 3:
        raise ValueError(f"views: expected three or more, got {len(views.corners)}")
    points = board.points().numpy().astype(np.float32)
    objects = [points[found.ids.numpy()][:, None] for found in views.corners.values()]
    pictures = [found.points_px.numpy().astype(np.float32)[:, None] for found in views.corners.values()]
    flags = {
        0: cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3,
        4: cv2.CALIB_FIX_K3,
        5: 0,
        8: cv2.CALIB_RATIONAL_MODEL,
    }[distortion]
    _, matrix, coefficients, turns, shifts, _, _, errors = cv2.calibrateCameraExtended(
        objects, pictures, (views.width, views.height), np.eye(3), np.zeros(5), flags=flags
    )
    lens = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *np.ravel(coefficients)[:distortion]]
    poses = [
        Pose(
            rotation=torch.from_numpy(cv2.Rodrigues(turn)[0].astype(np.float64)),
            translation=torch.from_numpy(np.asarray(shift, np.float64).reshape(3)),
        )
        for turn, shift in zip(turns, shifts, strict=True)
    ]
    return SingleCalibration(
        lens=torch.tensor([float(value) for value in lens], dtype=torch.float64),
        cam_from_board=dict(zip(views.corners, poses, strict=True)),
        residual_px=dict(zip(views.corners, np.ravel(errors).astype(float).tolist(), strict=True)),
    )
