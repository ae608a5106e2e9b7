"""What the tests of the residuals share: a hand before a camera, and contours that move with it."""

from dataclasses import dataclass

import pytest
import torch
from torch import Tensor

from tests.studio import Studio
from torchhand.files import load_hand_model
from torchhand.geometry import assumed_camera
from torchhand.hand import PoseConstraints, PoseSpace, named_pose_space, posture
from torchhand.view import HandProjector, PrimitiveContours, outline_table


@dataclass(frozen=True)
class Straight:
    """Points that move linearly with the free parameters: residuals must then be right in every direction."""

    start: Tensor
    slopes: Tensor
    """hands, points, 2, free"""
    free: Tensor

    @property
    def points_px(self) -> Tensor:
        return self.start + (self.slopes @ self.free[:, None, :, None]).squeeze(-1)

    def along(self, direction: Tensor) -> Tensor:
        return (direction[..., None, :] @ self.slopes).squeeze(-2)


@dataclass(frozen=True)
class Bench:
    contours: PrimitiveContours
    space: PoseSpace
    pose: Tensor
    reference: Tensor
    constraints: PoseConstraints

    @property
    def mask(self) -> Tensor:
        return self.contours.projector.silhouette(self.pose[0], self.reference[0])

    def straight(self, generator: torch.Generator, hands: int = 3, points: int = 40, free: int = 4) -> Straight:
        """Spread over a picture of 160 × 120 px."""
        size = torch.tensor((159.0, 119.0), dtype=torch.float64)
        return Straight(
            start=size * torch.rand(hands, points, 2, generator=generator, dtype=torch.float64),
            slopes=torch.randn(hands, points, 2, free, generator=generator, dtype=torch.float64),
            free=torch.randn(hands, free, generator=generator, dtype=torch.float64),
        )


@pytest.fixture(scope="session")
def bench() -> Bench:
    """An open hand, palm to the camera, upright."""
    model = load_hand_model()
    camera = assumed_camera(160, 120)
    projector = HandProjector(model.kinematics(dtype=torch.float64), camera)
    space = named_pose_space("dof26")
    pose = posture("open")
    pose[:3] = torch.tensor((0.0, 0.09, 0.30), dtype=torch.float64)
    reference = torch.tensor(((0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0)), dtype=torch.float64).T
    return Bench(
        contours=PrimitiveContours(projector, outline_table(8, 8, without=("palm_wrist",)), space.basis),
        space=space,
        pose=space.dof(space.free(pose))[None],
        reference=reference[None].contiguous(),
        constraints=PoseConstraints(model.skeleton),
    )


@pytest.fixture(scope="session")
def studio() -> Studio:
    return Studio()
