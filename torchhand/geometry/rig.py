"""What several cameras have in common: where they stand, what they see together, and signs of a misread pose."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.errors import require_kind
from torchhand.geometry.cameras import Camera

_GRID = 7  # rays per side of a picture
_DEPTHS = 40
_NEAREST, _FARTHEST = 0.02, 50.0  # depths of the samples, relative to the size of the rig
_AIMED_DEG = 8.0  # cameras around one object aim at it about this well
_WELL_AIMED_DEG = 5.0
_PARALLEL_DEG = 15.0
_RATIO = 4.0  # another reading must aim this much better


class Rig(tuple[Camera, ...]):
    """Several calibrated cameras that stand in one world: a tuple of them, for everything that takes cameras.

    Points of the world are metres where the cameras' translations are. Raises ValueError for no camera, and for a batch
    of cameras in the place of one; TypeError for what is no camera.
    """

    __slots__ = ()

    def __new__(cls, cameras: Iterable[Camera]) -> "Rig":
        rig = super().__new__(cls, cameras)
        if not rig:
            raise ValueError("cameras: expected at least one, got none")
        for camera in rig:
            require_kind("cameras", camera, Camera)
            if camera.rotation.ndim != 2:
                raise ValueError(f"cameras: expected single ones, got a batch {tuple(camera.rotation.shape[:-2])}")
        return rig

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(camera.name for camera in self)

    def named(self, name: str) -> Camera:
        """The camera of a name. Raises ValueError where not exactly one has it."""
        found = [camera for camera in self if camera.name == name]
        if len(found) != 1:
            raise ValueError(f"name: expected one of {', '.join(self.names)}, each once, got {name!r}")
        return found[0]

    def project(self, points_world: Float[Tensor, "*points 3"]) -> Float[Tensor, "cameras *points 2"]:
        """Pixels of points of the world, metres, in every camera's picture, as `Camera.project` has them: of points
        behind a camera too (`sees` tells which are not)."""
        return torch.stack([camera.project(points_world) for camera in self])

    def scaled(self, metres: float) -> "Rig":
        """The same cameras where one unit of their translations is so many metres."""
        return Rig(replace(camera, translation=metres * camera.translation) for camera in self)

    def to(self, *, dtype: torch.dtype | None = None, device: torch.device | str | None = None) -> "Rig":
        """The same cameras with their tensors moved."""
        return Rig(camera.to(dtype=dtype, device=device) for camera in self)

    def on(self, device: torch.device) -> "Rig":
        """The same cameras on a device (`torchhand.devices.sent_to`)."""
        return self.to(device=device)


def centres_world(cameras: Sequence[Camera]) -> Float[Tensor, "cameras 3"]:
    """Optical centres -Rᵀ t, in the unit of the translations."""
    return torch.stack([-(camera.rotation.mT @ camera.translation) for camera in cameras])


def axes_world(cameras: Sequence[Camera]) -> Float[Tensor, "cameras 3"]:
    """Unit viewing directions."""
    return torch.stack([camera.rotation[2] for camera in cameras])


def rig_size(cameras: Sequence[Camera]) -> float:
    """Largest distance between two optical centres; of a single camera its distance from the world's origin."""
    centres = centres_world(cameras)
    if len(cameras) == 1:
        return float(centres[0].norm())
    return float(torch.cdist(centres, centres).max())


def meeting_point(cameras: Sequence[Camera]) -> Float[Tensor, "3"]:
    """The point of the world nearest to all optical axes (least squares); of parallel axes one with least norm."""
    centres, axes = centres_world(cameras), axes_world(cameras)
    across = torch.eye(3, dtype=axes.dtype) - axes[:, :, None] * axes[:, None, :]
    normal = across.sum(0)
    right = (across @ centres[..., None]).sum(0).squeeze(-1)
    return torch.linalg.lstsq(normal, right[:, None], driver="gelsd").solution[:, 0]


def aim_error_deg(cameras: Sequence[Camera]) -> float:
    """Root mean square angle between the optical axes and the directions to the point where they nearly meet."""
    directions = meeting_point(cameras) - centres_world(cameras)
    cosine = torch.nn.functional.cosine_similarity(directions, axes_world(cameras), dim=-1)
    return float(cosine.clamp(-1, 1).acos().square().mean().sqrt().rad2deg())


def look_away(cameras: Sequence[Camera]) -> bool:
    """Whether the cameras look away from the point where their optical axes meet; not so where they are near parallel.

    Nearly parallel cameras, as of a stereo pair, may well diverge a little.
    """
    axes = axes_world(cameras)
    widest_deg = float((axes @ axes.T).min().clamp(-1, 1).acos().rad2deg())
    return widest_deg > _PARALLEL_DEG and aim_error_deg(cameras) > 90.0


def sees(camera: Camera, points_world: Float[Tensor, "points 3"]) -> Bool[Tensor, "points"]:
    """Whether the points lie before the camera and inside its picture."""
    points_cam = camera.cam_from_world(points_world)
    plane = camera.plane_from_cam(points_cam)
    is_before = (
        points_cam[:, 2] > 0 if camera.kind == "pinhole" else torch.ones_like(points_cam[:, 2], dtype=torch.bool)
    )
    # A lens model folds far directions back into the picture: only directions as steep as the corners' count.
    border = camera.plane_from_pixels(_grid_px(camera, 3))
    is_ahead = is_before & (plane.norm(dim=-1) <= 1.02 * border.norm(dim=-1).max())
    pixels = camera.pixels_from_plane(torch.where(is_ahead[:, None], plane, torch.zeros_like(plane)))
    size = torch.tensor((camera.width, camera.height), dtype=pixels.dtype)
    return is_ahead & ((pixels >= -0.5) & (pixels <= size - 0.5)).all(-1)


def common_view(cameras: Sequence[Camera]) -> Bool[Tensor, "cameras"]:
    """Cameras that see one point together: the largest such set over points sampled along all cameras' rays.

    Depths from 0.02 to 50 times the size of the rig are tried. A set of one means that no two cameras see anything
    together.
    """
    size = rig_size(cameras)
    if size <= 1e-9:
        size = 1.0
    depths = size * torch.logspace(
        math.log10(_NEAREST), math.log10(_FARTHEST), _DEPTHS, dtype=cameras[0].rotation.dtype
    )
    samples = [meeting_point(cameras)[None]]
    for camera in cameras:
        origins, directions = camera.rays(_grid_px(camera, _GRID))
        points_cam = origins[:, None] + depths[:, None] * directions[:, None]
        samples.append(((points_cam - camera.translation) @ camera.rotation).flatten(0, 1))
    points = torch.cat(samples)
    seen = torch.stack([sees(camera, points) for camera in cameras], -1)
    return seen[seen.sum(-1).argmax()]


def suspected_reading(cameras: Sequence[Camera]) -> str | None:
    """What is probably wrong with all rotations, where another reading of them makes the cameras look at one place.

    None where the cameras as given see a common volume and are aimed at it, or where no other reading does better. Two
    cameras or more are needed. Mistakes that still leave all cameras aimed at one point cannot be seen.
    """
    if len(cameras) < 2:
        return None
    given = aim_error_deg(cameras)
    sees_all = bool(common_view(cameras).all())
    if sees_all and given <= _AIMED_DEG:
        return None
    best, best_aim = None, min(_WELL_AIMED_DEG, given / _RATIO)
    for text, read in _readings(cameras).items():
        aim = aim_error_deg(read)
        if aim < best_aim and bool(common_view(read).all()):
            best, best_aim = text, aim
    return best


def _readings(cameras: Sequence[Camera]) -> dict[str, list[Camera]]:
    """What the numbers would mean in other conventions."""
    flip = torch.diag(torch.tensor((1.0, -1.0, -1.0), dtype=cameras[0].rotation.dtype))
    inverse = [
        replace(c, rotation=c.rotation.mT.contiguous(), translation=-(c.rotation.mT @ c.translation)) for c in cameras
    ]
    return {
        "R is transposed": [replace(c, rotation=c.rotation.mT.contiguous()) for c in cameras],
        "R and t are the camera's pose in the world, the inverse of what is expected": inverse,
        "the axes are OpenGL's (y up, z backward)": [
            replace(c, rotation=flip @ c.rotation, translation=flip @ c.translation) for c in cameras
        ],
        "R and t are the camera's pose in the world with OpenGL's axes (y up, z backward)": [
            replace(c, rotation=flip @ c.rotation, translation=flip @ c.translation) for c in inverse
        ],
    }


def _grid_px(camera: Camera, count: int) -> Float[Tensor, "points 2"]:
    """Pixels evenly spread over the picture, its corners included."""
    dtype = camera.intrinsics.dtype
    x = torch.linspace(0, camera.width - 1, count, dtype=dtype)
    y = torch.linspace(0, camera.height - 1, count, dtype=dtype)
    return torch.cartesian_prod(x, y)
