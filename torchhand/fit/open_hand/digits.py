"""The measured digits of an open hand as an observation (Ouhaddi and Horain 1998, section 7.1)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.fit import Equations, OwnFactor, PosedHands
from torchhand.geometry import Camera
from torchhand.hand import DOFS, HandKinematics, HandPose
from torchhand.hand.kinematics import TIP_DEPTH
from torchhand.image import HandRegions
from torchhand.view.contours import varied_shapes

# Standard deviations of what is measured, fractions of the hand's length in the picture.
_TIP_STD = 0.008  # a fingertip
_AXIS_STD = 0.008  # a joint's distance from the axis of its digit
_WEB_STD = 0.015  # the base of a finger, along its axis
_WRIST_STD = 0.06
_STEP = 1e-6  # of the numerical derivative, metres and radians


@dataclass(frozen=True, kw_only=True)
class DigitObservation(OwnFactor):
    """Tips, bases and axes of five digits and the wrist in one picture. Its own factor: nothing is associated."""

    kinematics: HandKinematics
    camera: Camera
    tip: Float[Tensor, "5 2"]
    """px, as all places; thumb to little finger."""
    base: Float[Tensor, "5 2"]
    along: Float[Tensor, "5 2"]
    """Unit vectors from base to tip."""
    wrist: Float[Tensor, "2"]
    length_px: float
    """Length of the hand in the picture."""
    trust: float = 1.0
    """Factor on all residuals; above 0."""

    @classmethod
    def of(cls, regions: HandRegions, kinematics: HandKinematics, camera: Camera) -> "DigitObservation":
        """The digits that were measured in a silhouette, on the device of the kinematics."""
        device = kinematics.default_shape.device
        return cls(
            kinematics=kinematics,
            camera=camera,
            tip=_rows([digit.tip for digit in regions.digits], device),
            base=_rows([digit.base for digit in regions.digits], device),
            along=_rows([digit.direction for digit in regions.digits], device),
            wrist=_rows([regions.wrist], device)[0],
            length_px=regions.hand_length,
        )

    def corrected(self, pose: HandPose, shape: Float[Tensor, "shape"], drawn: HandRegions) -> "DigitObservation":
        """The digits free of the measurement's own bias: `drawn` is measured on the silhouette of the model posed so.

        Webs lie where the flesh of two fingers meets, not where the model's formula has them, and axes of curved digits
        end beside their tips; but the same so in both pictures.
        """
        tips, bases, _, _ = self._points(pose.dofs, shape, pose.reference)
        own = DigitObservation.of(drawn, self.kinematics, self.camera)
        base = torch.cat((self.base[:1], self.base[1:] + bases - own.base[1:]))
        return replace(self, tip=self.tip + tips - own.tip, base=base)

    def residuals(
        self, dofs: Float[Tensor, "n 36"], shape: Float[Tensor, "*#n shape"], reference: Float[Tensor, "3 3"]
    ) -> Float[Tensor, "n rows"]:
        """How far the digits of hands are from the measured ones, in standard deviations: tips, bases along their
        digits, two joints of each digit across its axis, and the wrist."""
        tips, bases, joints, wrist = self._points(dofs, shape, reference)
        across = torch.stack((-self.along[:, 1], self.along[:, 0]), -1)
        parts = (
            (tips - self.tip) / _TIP_STD,
            ((bases - self.base[1:]) * self.along[1:]).sum(-1) / _WEB_STD,
            ((joints - self.tip[:, None]) * across[:, None]).sum(-1) / _AXIS_STD,
            (wrist - self.wrist) / _WRIST_STD,
        )
        return self.trust / self.length_px * torch.cat([part.flatten(1) for part in parts], -1)

    def equations(self, hands: PosedHands) -> Equations:
        """Normal equations in the DOFs, and in the shape where it is unknown; by forward differences."""
        space, shape = self.kinematics.shape_space, hands.shape
        columns = () if hands.unknowns is None else hands.unknowns.columns
        shapes, steps = varied_shapes(space, shape, columns)
        varied = torch.eye(len(DOFS), dtype=shape.dtype, device=shape.device)
        residuals, slopes = [], []
        for dofs, reference in zip(hands.pose.dofs, hands.pose.reference, strict=True):
            poses = torch.cat((dofs.expand(len(shapes), -1), dofs + _STEP * varied))
            found = self.residuals(poses, torch.cat((shapes, shape.expand(len(DOFS), -1))), reference)
            here, by_shape, by_pose = found.split((1, len(columns), len(DOFS)))
            residuals.append(here[0])
            slopes.append(torch.cat(((by_pose - here).T / _STEP, (by_shape - here).T / steps), -1))
        residual, slope = torch.stack(residuals), torch.stack(slopes)
        rows, shared = slope[..., : len(DOFS)], slope[..., len(DOFS) :]
        return Equations.of_rows(
            residual,
            torch.ones_like(residual),
            rows,
            0.5 * residual.square().sum(-1),
            shared=None if hands.unknowns is None else torch.nn.functional.pad(shared, (0, len(hands.unknowns.extra))),
        )

    def _points(self, dofs: Tensor, shape: Tensor, reference: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Tips (5), bases of the fingers (4), two joints of each digit and the wrist in the picture, px."""
        points = self.kinematics(dofs, shape, root_reference=reference).keypoints
        metric = self.kinematics.shape_space.metric(shape)
        digits = points[..., 1:, :].unflatten(-2, (5, 4))
        depth = (TIP_DEPTH * metric["hand_length"])[..., None, None]
        tips = digits[..., 3, :] + depth * _unit(digits[..., 3, :] - digits[..., 2, :])
        fingers = digits[..., 1:, :, :]
        web = metric["web_length"][..., None, None]
        bases = fingers[..., 0, :] + web * _unit(fingers[..., 1, :] - fingers[..., 0, :])
        project = self.camera.project
        return project(tips), project(bases), project(digits[..., 1:3, :]), project(points[..., 0, :])


def _rows(points: Sequence[np.ndarray], device: torch.device) -> Float[Tensor, "n 2"]:
    return torch.from_numpy(np.stack(points)).double().to(device)


def _unit(vector: Tensor) -> Tensor:
    return vector / vector.norm(dim=-1, keepdim=True)
