"""First pose and shape of an open hand from its measured digits (Ouhaddi and Horain 1998, section 7.1)."""

import math
from collections.abc import Sequence
from copy import copy
from functools import partial

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.fit.detect import facing_rotation, turned_in_picture
from torchhand.fit.open_hand.problem import OpenHandProblem, linearized
from torchhand.geometry import Camera
from torchhand.hand import HandKinematics, posture
from torchhand.hand.kinematics import TIP_DEPTH
from torchhand.image import HandRegions
from torchhand.numerics import LevenbergMarquardtSettings, levenberg_marquardt

# Standard deviations of what is measured, fractions of the hand's length in the picture.
_TIP_STD = 0.008  # a fingertip
_AXIS_STD = 0.008  # a joint's distance from the axis of its digit
_WEB_STD = 0.015  # the base of a finger, along its axis
_WRIST_STD = 0.06


def placed_open_hand(
    regions: HandRegions, kinematics: HandKinematics, camera: Camera, facing: str
) -> tuple[Float[Tensor, "36"], Float[Tensor, "3 3"]]:
    """The open posture at the measured wrist, angle and size, square to the camera, and the root's orientation."""
    pose = posture("open", dtype=torch.float64).to(kinematics.default_shape.device)
    space = kinematics.shape_space
    length = float(space.default[space.names.index("hand_length")])
    focal_px = 0.5 * float(camera.intrinsics[0, 0] + camera.intrinsics[1, 1])
    is_pinhole = camera.kind == "pinhole"
    depth = focal_px * length / regions.hand_length if is_pinhole else 1.0
    plane = camera.plane_from_pixels(pose.new_tensor(regions.wrist))
    pose[:2], pose[2], pose[3:6] = plane * (depth if is_pinhole else 1.0), depth, 0.0
    angle = math.atan2(float(regions.axis[0]), -float(regions.axis[1]))
    return pose, turned_in_picture(facing_rotation(facing), angle).to(pose.device)


class DigitResiduals:
    """How far the model's digits are from the measured ones, in standard deviations."""

    def __init__(self, regions: HandRegions, problem: OpenHandProblem) -> None:
        device = problem.std.device
        self._tip = _rows([digit.tip for digit in regions.digits], device)
        self._base = _rows([digit.base for digit in regions.digits], device)
        self._along = _rows([digit.direction for digit in regions.digits], device)
        self._across = torch.stack((-self._along[:, 1], self._along[:, 0]), -1)
        self._wrist = torch.from_numpy(regions.wrist).double().to(device)
        self._unit_px = regions.hand_length
        self._problem = problem

    def corrected(self, values: Float[Tensor, "n"], drawn: HandRegions) -> "DigitResiduals":
        """The residuals free of the measurement's own bias: `drawn` is measured on the silhouette of the model.

        Webs lie where the flesh of two fingers meets, not where the model's formula has them, and axes of curved digits
        end beside their tips; but the same so in both pictures.
        """
        tips, bases, _, _ = self._points(values)
        better, device = copy(self), tips.device
        better._tip = self._tip + tips - _rows([digit.tip for digit in drawn.digits], device)
        better._base = self._base.clone()
        better._base[1:] += bases - _rows([digit.base for digit in drawn.digits], device)[1:]
        return better

    def __call__(self, values: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch rows"]:
        """Tips, bases along their digits, two joints of each digit across its axis, and the wrist."""
        tips, bases, joints, wrist = self._points(values)
        parts = (
            (tips - self._tip) / _TIP_STD,
            ((bases - self._base[1:]) * self._along[1:]).sum(-1) / _WEB_STD,
            ((joints - self._tip[:, None]) * self._across[:, None]).sum(-1) / _AXIS_STD,
            (wrist - self._wrist) / _WRIST_STD,
        )
        return torch.cat([part.reshape(*values.shape[:-1], -1) for part in parts], -1) / self._unit_px

    def _points(self, values: Float[Tensor, "*batch n"]) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Tips (5), bases of the fingers (4), two joints of each digit and the wrist in the picture, px."""
        problem = self._problem
        pose, shape = problem.split(values)
        points = problem.kinematics(pose, shape, root_reference=problem.root_reference).keypoints
        metric = problem.kinematics.shape_space.metric(shape)
        digits = points[..., 1:, :].unflatten(-2, (5, 4))
        depth = (TIP_DEPTH * metric["hand_length"])[..., None, None]
        tips = digits[..., 3, :] + depth * _unit(digits[..., 3, :] - digits[..., 2, :])
        fingers = digits[..., 1:, :, :]
        web = metric["web_length"][..., None, None]
        bases = fingers[..., 0, :] + web * _unit(fingers[..., 1, :] - fingers[..., 0, :])
        project = problem.camera.project
        return project(tips), project(bases), project(digits[..., 1:3, :]), project(points[..., 0, :])


def fit_digits(digits: DigitResiduals, problem: OpenHandProblem) -> Float[Tensor, "n"]:
    """Most probable unknowns given tips, axes and bases of the digits and the wrist."""

    found = levenberg_marquardt(
        partial(linearized, (digits, problem.prior)),
        torch.zeros_like(problem.std),
        lower=problem.lower,
        upper=problem.upper,
        settings=LevenbergMarquardtSettings(iterations=15, cost_tolerance=1e-4),
    )
    return found.values


def _rows(points: Sequence[np.ndarray], device: torch.device) -> Float[Tensor, "n 2"]:
    return torch.from_numpy(np.stack(points)).double().to(device)


def _unit(vector: Tensor) -> Tensor:
    return vector / vector.norm(dim=-1, keepdim=True)
