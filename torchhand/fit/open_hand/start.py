"""First pose and shape of an open hand from its measured digits (paper 000, section 7.1)."""

import math
from collections.abc import Sequence
from copy import copy

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.fit.detect import facing_rotation, turned_in_picture
from torchhand.fit.open_hand.problem import OpenHandProblem
from torchhand.fit.open_hand.settings import OpenHandSettings
from torchhand.geometry import Camera
from torchhand.hand import HandKinematics, posture
from torchhand.hand.kinematics import TIP_DEPTH
from torchhand.image import HandRegions
from torchhand.numerics import LevenbergMarquardtSettings, RobustLoss, levenberg_marquardt

_STEP = 1e-4  # of the numerical derivative, prior standard deviations


def placed_open_hand(
    regions: HandRegions, kinematics: HandKinematics, camera: Camera, facing: str
) -> tuple[Float[Tensor, "36"], Float[Tensor, "3 3"]]:
    """The open posture at the measured wrist, angle and size, square to the camera, and the root's orientation."""
    pose = posture("open")
    space = kinematics.shape_space
    length = float(space.default[space.names.index("hand_length")])
    focal_px = 0.5 * float(camera.intrinsics[0, 0] + camera.intrinsics[1, 1])
    is_pinhole = camera.kind == "pinhole"
    depth = focal_px * length / regions.hand_length if is_pinhole else 1.0
    plane = camera.plane_from_pixels(torch.tensor(regions.wrist, dtype=pose.dtype))
    pose[:2], pose[2], pose[3:6] = plane * (depth if is_pinhole else 1.0), depth, 0.0
    angle = math.atan2(float(regions.axis[0]), -float(regions.axis[1]))
    return pose, turned_in_picture(facing_rotation(facing), angle)


class DigitResiduals:
    """How far the model's digits are from the measured ones, in standard deviations, and the derivative."""

    def __init__(
        self,
        regions: HandRegions,
        problem: OpenHandProblem,
        kinematics: HandKinematics,
        camera: Camera,
        root_reference: Float[Tensor, "3 3"],
        settings: OpenHandSettings,
    ) -> None:
        self._tip = _rows([digit.tip for digit in regions.digits])
        self._base = _rows([digit.base for digit in regions.digits])
        self._along = _rows([digit.direction for digit in regions.digits])
        self._across = torch.stack((-self._along[:, 1], self._along[:, 0]), -1)
        self._wrist = torch.from_numpy(regions.wrist).double()
        self._unit = regions.hand_length
        self._problem, self._kinematics, self._camera = problem, kinematics, camera
        self._root_reference, self._settings = root_reference, settings

    def corrected(self, values: Float[Tensor, "n"], drawn: HandRegions) -> "DigitResiduals":
        """The same, free of what the measuring itself adds: `drawn` is measured on the model's own silhouette.

        Webs lie where the flesh of two fingers meets, not where the model's formula has them, and axes of curved digits
        end beside their tips; but the same so in both pictures.
        """
        tips, bases, _, _ = self._points(values)
        better = copy(self)
        better._tip = self._tip + tips - _rows([digit.tip for digit in drawn.digits])
        better._base = self._base.clone()
        better._base[1:] += bases - _rows([digit.base for digit in drawn.digits])[1:]
        return better

    def __call__(self, values: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch rows"]:
        """Tips, bases along their digits, two joints of each digit across its axis, and the wrist."""
        settings = self._settings
        tips, bases, joints, wrist = self._points(values)
        parts = (
            (tips - self._tip) / settings.tip_std,
            ((bases - self._base[1:]) * self._along[1:]).sum(-1) / settings.web_std,
            ((joints - self._tip[:, None]) * self._across[:, None]).sum(-1) / settings.axis_std,
            (wrist - self._wrist) / settings.wrist_std,
        )
        return torch.cat([part.reshape(*values.shape[:-1], -1) for part in parts], -1) / self._unit

    def _points(self, values: Float[Tensor, "*batch n"]) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Tips (5), bases of the fingers (4), two joints of each digit and the wrist in the picture, px."""
        camera = self._camera
        pose, shape = self._problem.split(values)
        points = self._kinematics(pose, shape, root_reference=self._root_reference).keypoints
        metric = self._kinematics.shape_space.metric(shape)
        digits = points[..., 1:, :].unflatten(-2, (5, 4))
        depth = (TIP_DEPTH * metric["hand_length"])[..., None, None]
        tips = camera.project(digits[..., 3, :] + depth * _unit(digits[..., 3, :] - digits[..., 2, :]))
        fingers = digits[..., 1:, :, :]
        web = metric["web_length"][..., None, None]
        bases = camera.project(fingers[..., 0, :] + web * _unit(fingers[..., 1, :] - fingers[..., 0, :]))
        return tips, bases, camera.project(digits[..., 1:3, :]), camera.project(points[..., 0, :])

    def linearised(self, values: Float[Tensor, "n"]) -> tuple[Float[Tensor, "rows"], Float[Tensor, "rows n"]]:
        """Residuals and their Jacobian, by forward differences."""
        steps = _STEP * torch.eye(len(values), dtype=values.dtype)
        measured = self(torch.cat((values[None], values + steps)))
        return measured[0], (measured[1:] - measured[0]).T / _STEP


def fit_digits(digits: DigitResiduals, problem: OpenHandProblem) -> Float[Tensor, "n"]:
    """Most probable unknowns given tips, axes and bases of the digits and the wrist."""

    def linearise(values: Tensor) -> tuple[Tensor, Tensor]:
        measured, slope = digits.linearised(values)
        known, known_slope = problem.prior(values)
        return torch.cat((measured, known)), torch.cat((slope, known_slope))

    found = levenberg_marquardt(
        linearise,
        torch.zeros(problem.size, dtype=torch.float64),
        lower=problem.lower,
        upper=problem.upper,
        robust=RobustLoss(kind="huber", scale=3.0),
        settings=LevenbergMarquardtSettings(iterations=15, cost_tolerance=1e-4),
    )
    return found.values


def _rows(points: Sequence[np.ndarray]) -> Float[Tensor, "n 2"]:
    return torch.from_numpy(np.stack(points)).double()


def _unit(vector: Tensor) -> Tensor:
    return vector / vector.norm(dim=-1, keepdim=True)
