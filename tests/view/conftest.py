"""What the tests of the views share: cameras, and hands in front of them."""

import pytest
import torch
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.geometry import Camera, rotation_from_vector
from torchhand.hand import Primitives
from torchhand.view.outlines import HandProjector

LENSES = {0: (), 5: (0.08, -0.05, 0.002, -0.001, 0.01), 8: (0.08, -0.05, 0.002, -0.001, 0.01, 0.02, 0.01, -0.004)}
DISTANCE = 0.5  # metres


class Scene:
    """Cameras at the world's origin, and hands of any pose that fill the picture half a metre away."""

    def camera(self, kind: str = "pinhole", *, width: int = 160, height: int = 120, lens: int = 0) -> Camera:
        """Orthographic cameras have the same scale at the hand's distance."""
        focal = 1.1 * width
        scale = focal / DISTANCE if kind == "orthographic" else focal
        intrinsics = ((scale, 0.0, (width - 1) / 2), (0.0, scale, (height - 1) / 2), (0.0, 0.0, 1.0))
        return Camera(
            intrinsics=torch.tensor(intrinsics, dtype=torch.float64),
            rotation=torch.eye(3, dtype=torch.float64),
            translation=torch.zeros(3, dtype=torch.float64),
            distortion=torch.tensor(LENSES[lens], dtype=torch.float64),
            width=width,
            height=height,
            kind="orthographic" if kind == "orthographic" else "pinhole",
        )

    def pose(self, generator: torch.Generator, *batch: int) -> tuple[Tensor, Tensor]:
        """A pose with joint angles anywhere within the limits, and a root reference turned any way."""
        skeleton = load_hand_model().skeleton
        fraction = torch.rand(*batch, 30, generator=generator, dtype=torch.float64)
        pose = torch.zeros(*batch, 36, dtype=torch.float64)
        pose[..., 6:] = skeleton.lower + fraction * (skeleton.upper - skeleton.lower)
        reference = rotation_from_vector(2 * torch.randn(3, generator=generator, dtype=torch.float64))
        pose[..., :3] = torch.tensor((0.0, 0.0, DISTANCE), dtype=torch.float64) - 0.09 * reference[:, 1]
        pose[..., 3:6] = 0.1 * torch.randn(*batch, 3, generator=generator, dtype=torch.float64)
        return pose, reference

    def projector(self, camera: Camera, side: str = "right") -> HandProjector:
        kinematics = load_hand_model().kinematics("left" if side == "left" else "right", dtype=torch.float64)
        return HandProjector(kinematics, camera)

    def primitives(self, projector: HandProjector, pose: Tensor, reference: Tensor) -> Primitives:
        """In the camera's frame."""
        return projector.primitives_cam(projector.frames(pose, reference))


@pytest.fixture(scope="session")
def scene() -> Scene:
    return Scene()
