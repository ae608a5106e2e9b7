"""What the tests of fits share: a hand before a camera with the contours that move with it, people, skin that moves."""

from dataclasses import dataclass

import pytest
import torch
from torch import Tensor

from tests.studio import Studio
from torchhand.files import load_hand_model
from torchhand.geometry import assumed_camera
from torchhand.hand import HandPose, PoseConstraints, PoseSpace, named_pose_space, posture
from torchhand.view import HandProjector, PrimitiveContours, outline_table


@dataclass(frozen=True)
class StraightSkin:
    """Points that move linearly with the free parameters: residuals must then be right in every direction."""

    start: Tensor
    slopes: Tensor
    """hands, points, 3, free"""
    free: Tensor

    @property
    def points(self) -> Tensor:
        return self.start + (self.slopes @ self.free[:, None, :, None]).squeeze(-1)

    def along(self, direction: Tensor) -> Tensor:
        return (direction[..., None, :] @ self.slopes).squeeze(-2)


@dataclass(frozen=True)
class Bench:
    contours: PrimitiveContours
    space: PoseSpace
    hand: HandPose
    """(1,)"""
    constraints: PoseConstraints

    @property
    def mask(self) -> Tensor:
        return self.contours.projector.silhouette(self.hand.dofs[0], self.hand.reference[0])


@pytest.fixture
def skin(generator: torch.Generator) -> StraightSkin:
    """Three hands of 40 points within a metre or two of the origin, and four free parameters."""

    def normal(*sizes: int) -> Tensor:
        return torch.randn(*sizes, generator=generator, dtype=torch.float64)

    return StraightSkin(start=normal(3, 40, 3), slopes=normal(3, 40, 3, 4), free=0.1 * normal(3, 4))


@pytest.fixture(scope="session")
def bench() -> Bench:
    """An open hand, palm to the camera, upright."""
    model = load_hand_model()
    projector = HandProjector(model.kinematics(dtype=torch.float64), assumed_camera(160, 120))
    space = named_pose_space("dof26")
    pose = posture("open", dtype=torch.float64)
    pose[:3] = torch.tensor((0.0, 0.09, 0.30), dtype=torch.float64)
    reference = torch.tensor(((0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0)), dtype=torch.float64).T
    return Bench(
        contours=PrimitiveContours(projector, outline_table(8, 8, without=("palm_wrist",))),
        space=space,
        hand=HandPose.of(space.dof(space.free(pose))[None], reference.contiguous()),
        constraints=PoseConstraints(model.skeleton),
    )


@pytest.fixture(scope="session")
def studio() -> Studio:
    return Studio()
