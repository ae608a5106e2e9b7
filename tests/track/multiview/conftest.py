"""A small rig around a hand, and the exact silhouettes that its cameras see."""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.geometry import Camera, rotation_from_vector
from torchhand.hand import Hand, posture
from torchhand.simulate import named_rig
from torchhand.view import mesh_silhouette

Pose = tuple[Tensor, Tensor]
"""The pose with a zero rotation vector, and world_from_hand."""


@pytest.fixture(scope="session")
def rig_hand() -> Hand:
    return load_hand_model().hand(side="right", dtype=torch.float64)


@pytest.fixture(scope="session")
def rig() -> list[Camera]:
    return named_rig("frame4", size=(240, 180))


@pytest.fixture(scope="session")
def pose_at() -> Callable[..., Pose]:
    """A posture upright in the rig's middle, back to the front camera, a little turned and moved."""

    def pose_at(name: str = "open", *, turn: float = 0.3, place: tuple[float, float, float] = (0.0, 0.08, 0.0)) -> Pose:
        upright = torch.diag(torch.tensor((1.0, -1.0, -1.0), dtype=torch.float64))
        around = rotation_from_vector(torch.tensor((0.0, turn, 0.0), dtype=torch.float64))
        pose = posture(name, dtype=torch.float64).clone()
        pose[:3] = torch.tensor(place, dtype=torch.float64)
        return pose, around @ upright

    return pose_at


@pytest.fixture(scope="session")
def masks_of(rig_hand: Hand, rig: list[Camera]) -> Callable[[Pose], list[Tensor | None]]:
    """The silhouettes of a posed hand in all views."""

    def masks_of(pose: Pose) -> list[Tensor | None]:
        state = rig_hand(pose[0], root_reference=pose[1])
        return [mesh_silhouette(state.vertices, rig_hand.faces, camera) for camera in rig]

    return masks_of
