"""What the tests of volumes share: rigs of cameras, balls and boxes, and their silhouettes."""

import math

import pytest
import torch
from torch import Tensor

from torchhand.geometry import Camera, rotation_from_vector

LENSES = {0: (), 5: (0.08, -0.05, 0.002, -0.001, 0.01)}


class Rigs:
    """Cameras around the world's origin."""

    def looking(
        self,
        position: tuple[float, float, float],
        *,
        width: int = 160,
        height: int = 120,
        focal: float = 130.0,
        kind: str = "pinhole",
        lens: int = 0,
        roll: float = 0.0,
        name: str = "cam0",
        at: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> Camera:
        """A camera at `position` that looks at `at`."""
        place, aim = torch.tensor(position, dtype=torch.float64), torch.tensor(at, dtype=torch.float64)
        ahead = (aim - place) / (aim - place).norm()
        across = torch.linalg.cross(ahead, torch.eye(3, dtype=torch.float64)[int(ahead.abs().argmin())])
        across = across / across.norm()
        frame = torch.stack((across, torch.linalg.cross(ahead, across), ahead))
        rotation = rotation_from_vector(torch.tensor((0.0, 0.0, roll), dtype=torch.float64)) @ frame
        scale = focal / float((aim - place).norm()) if kind == "orthographic" else focal
        intrinsics = [[scale, 0.0, (width - 1) / 2 + 1.3], [0.0, 1.05 * scale, (height - 1) / 2 - 2.1], [0, 0, 1.0]]
        return Camera(
            intrinsics=torch.tensor(intrinsics, dtype=torch.float64),
            rotation=rotation,
            translation=-rotation @ place,
            distortion=torch.tensor(LENSES[lens], dtype=torch.float64),
            width=width,
            height=height,
            kind="orthographic" if kind == "orthographic" else "pinhole",
            name=name,
        )

    def random(self, generator: torch.Generator, count: int, **options: object) -> list[Camera]:
        """Cameras anywhere around the origin, 0.35 to 0.5 m away."""
        cameras = []
        for index in range(count):
            place = torch.randn(3, generator=generator, dtype=torch.float64)
            distance, turn = torch.rand(2, generator=generator, dtype=torch.float64).tolist()
            x, y, z = ((0.35 + 0.15 * distance) * place / place.norm()).tolist()
            roll = 2 * math.pi * turn
            cameras.append(self.looking((x, y, z), roll=roll, name=f"cam{index}", **options))  # pyright: ignore
        return cameras

    def ball(self, camera: Camera, centre: Tensor, radius: Tensor | float) -> Tensor:
        """Pixels whose rays meet a ball, or one of a batch of balls (n, 3)."""
        rows, columns = (torch.arange(n, dtype=torch.float64) for n in (camera.height, camera.width))
        origin, direction = camera.rays(torch.stack(torch.meshgrid(columns, rows, indexing="xy"), -1))
        direction = direction / direction.norm(dim=-1, keepdim=True)
        mask = torch.zeros(camera.height, camera.width, dtype=torch.bool)
        sizes = torch.as_tensor(radius, dtype=torch.float64).expand(centre.reshape(-1, 3).shape[0])
        for middle, size in zip(camera.cam_from_world(centre.reshape(-1, 3)), sizes, strict=True):
            arm = middle - origin
            along = (arm * direction).sum(-1)
            mask |= ((arm - along[..., None] * direction).norm(dim=-1) <= size) & (along > 0)
        return mask


@pytest.fixture(scope="session")
def rigs() -> Rigs:
    return Rigs()
