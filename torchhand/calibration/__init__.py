"""Cameras from pictures of a board: corners, each camera alone, bundle adjustment of a rig, and how good it is."""

from torchhand.calibration.board import Board, BoardCorners, draw_board, find_board, other_board
from torchhand.calibration.camera import CameraViews, FrameIndex
from torchhand.calibration.quality import QualityLimits, shortcomings
from torchhand.calibration.reprojection import Pose
from torchhand.calibration.rig import RigCalibration, calibrate_rig, check_board
from torchhand.calibration.table import calibration_table

__all__ = [
    "Board",
    "BoardCorners",
    "CameraViews",
    "FrameIndex",
    "Pose",
    "QualityLimits",
    "RigCalibration",
    "calibrate_rig",
    "calibration_table",
    "check_board",
    "draw_board",
    "find_board",
    "other_board",
    "shortcomings",
]
