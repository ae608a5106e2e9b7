"""Cameras in OpenCV's convention: x right, y down, z forward, the centre of the first pixel is (0, 0)."""

import math
from dataclasses import dataclass, replace
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

ASSUMED_HORIZONTAL_FOV_DEG = 55.0
DISTORTION_LENGTHS = (0, 4, 5, 8, 12, 14)


@dataclass(frozen=True, kw_only=True)
class Camera:
    """One camera, or a batch of cameras of one picture size."""

    intrinsics: Float[Tensor, "*batch 3 3"]
    """K in pixels; of an orthographic camera its diagonal holds pixels per metre."""
    rotation: Float[Tensor, "*batch 3 3"]
    """cam_from_world."""
    translation: Float[Tensor, "*batch 3"]
    """cam_from_world, metres."""
    distortion: Float[Tensor, "*batch k"]
    """OpenCV's order k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [τx τy]]]]; k is 0, 4, 5, 8, 12 or 14."""
    width: int
    """px"""
    height: int
    """px"""
    kind: Literal["pinhole", "orthographic"] = "pinhole"
    name: str = "cam0"
    is_assumed: bool = False
    """True where no calibration was given and a field of view was assumed."""

    def __post_init__(self) -> None:
        if self.distortion.shape[-1] not in DISTORTION_LENGTHS:
            raise ValueError(f"distortion: expected {DISTORTION_LENGTHS} coefficients, got {self.distortion.shape[-1]}")
        if self.kind == "orthographic" and self.has_distortion:
            raise ValueError("distortion: an orthographic camera has none")

    @property
    def has_distortion(self) -> bool:
        return self.distortion.shape[-1] > 0 and bool((self.distortion != 0).any())

    def to(self, *, dtype: torch.dtype | None = None, device: torch.device | str | None = None) -> "Camera":
        """The same camera with its tensors moved."""
        moved = {
            name: getattr(self, name).to(dtype=dtype, device=device)
            for name in ("intrinsics", "rotation", "translation", "distortion")
        }
        return replace(self, **moved)

    def resized(self, scale: float) -> "Camera":
        """The camera of the picture resampled by `scale`, pixel centres kept at integers: x' = (x + ½) scale - ½."""
        shift = torch.eye(3, dtype=self.intrinsics.dtype, device=self.intrinsics.device)
        shift[0, 0] = shift[1, 1] = scale
        shift[:2, 2] = 0.5 * scale - 0.5
        return replace(
            self,
            intrinsics=shift @ self.intrinsics,
            width=max(1, round(self.width * scale)),
            height=max(1, round(self.height * scale)),
        )

    def cam_from_world(self, points_world: Float[Tensor, "*points 3"]) -> Float[Tensor, "*points 3"]:
        """Points in the camera frame, metres; camera batches broadcast against the leading dimensions of the points."""
        rotation, translation = _match(self.rotation, 2, points_world), _match(self.translation, 1, points_world)
        return (rotation @ points_world[..., None]).squeeze(-1) + translation

    def pixels_from_plane(self, plane: Float[Tensor, "*points 2"]) -> Float[Tensor, "*points 2"]:
        """Pixels of points of the normalised image plane (x/z, y/z; orthographic: x, y in metres), distorted."""
        distorted = distort(plane, _match(self.distortion, 1, plane)) if self.has_distortion else plane
        intrinsics = _match(self.intrinsics, 2, plane)
        return (intrinsics[..., :2, :2] @ distorted[..., None]).squeeze(-1) + intrinsics[..., :2, 2]

    def plane_from_pixels(self, points_px: Float[Tensor, "*points 2"]) -> Float[Tensor, "*points 2"]:
        """Points of the normalised image plane that appear at the given pixels; inverse of `pixels_from_plane`."""
        intrinsics = _match(self.intrinsics, 2, points_px)
        centred = points_px - intrinsics[..., :2, 2]
        plane = torch.linalg.solve(intrinsics[..., :2, :2], centred[..., None]).squeeze(-1)
        return undistort(plane, _match(self.distortion, 1, plane)) if self.has_distortion else plane

    def plane_from_cam(self, points_cam: Float[Tensor, "*points 3"]) -> Float[Tensor, "*points 2"]:
        """Normalised image plane; depths at or behind the camera give non-finite or mirrored points."""
        return points_cam[..., :2] if self.kind == "orthographic" else points_cam[..., :2] / points_cam[..., 2:]

    def project(self, points_world: Float[Tensor, "*points 3"]) -> Float[Tensor, "*points 2"]:
        """Pixels of points given in the world frame, metres."""
        return self.pixels_from_plane(self.plane_from_cam(self.cam_from_world(points_world)))

    def rays(self, points_px: Float[Tensor, "*points 2"]) -> tuple[Float[Tensor, "*points 3"], Float[Tensor, "*points 3"]]:
        """Origin and direction in the camera frame of the ray through each pixel; directions have z = 1."""
        plane = self.plane_from_pixels(points_px)
        one, zero = torch.ones_like(plane[..., :1]), torch.zeros_like(plane)
        if self.kind == "orthographic":
            return torch.cat((plane, 0 * one), -1), torch.cat((zero, one), -1)
        return torch.cat((zero, 0 * one), -1), torch.cat((plane, one), -1)


def _match(parameter: Tensor, own: int, points: Tensor) -> Tensor:
    """`parameter` of shape (*batch, own dims) with as many leading dimensions as `points` has, for broadcasting."""
    batch = parameter.shape[: parameter.ndim - own]
    missing = points.ndim - 1 - len(batch)
    return parameter.reshape(*batch, *(1,) * missing, *parameter.shape[len(batch) :]) if missing > 0 and batch else parameter


def assumed_camera(
    width: int, height: int, *, horizontal_fov_deg: float = ASSUMED_HORIZONTAL_FOV_DEG, dtype: torch.dtype = torch.float64
) -> Camera:
    """An ideal pinhole camera at the world's origin for pictures without calibration; marked as assumed."""
    if not 1.0 <= horizontal_fov_deg <= 170.0:
        raise ValueError(f"horizontal_fov_deg: expected 1 to 170, got {horizontal_fov_deg}")
    focal_px = 0.5 * width / math.tan(math.radians(horizontal_fov_deg) / 2)
    intrinsics = [[focal_px, 0.0, (width - 1) / 2], [0.0, focal_px, (height - 1) / 2], [0.0, 0.0, 1.0]]
    return Camera(
        intrinsics=torch.tensor(intrinsics, dtype=dtype),
        rotation=torch.eye(3, dtype=dtype),
        translation=torch.zeros(3, dtype=dtype),
        distortion=torch.zeros(0, dtype=dtype),
        width=width,
        height=height,
        is_assumed=True,
    )


def distort(plane: Float[Tensor, "*points 2"], coefficients: Float[Tensor, "*batch k"]) -> Float[Tensor, "*points 2"]:
    """OpenCV's lens model (rational, tangential, thin prism, tilted sensor) on the normalised image plane."""
    k = [coefficients[..., i] for i in range(coefficients.shape[-1])]
    k += [torch.zeros_like(k[0])] * (14 - len(k))
    x, y = plane.unbind(-1)
    r2 = x * x + y * y
    radial = (1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))) / (1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7])))
    xd = x * radial + 2 * k[2] * x * y + k[3] * (r2 + 2 * x * x) + k[8] * r2 + k[9] * r2 * r2
    yd = y * radial + k[2] * (r2 + 2 * y * y) + 2 * k[3] * x * y + k[10] * r2 + k[11] * r2 * r2
    distorted = torch.stack((xd, yd), -1)
    return _tilt(distorted, k[12], k[13]) if coefficients.shape[-1] == 14 else distorted


def undistort(
    distorted: Float[Tensor, "*points 2"], coefficients: Float[Tensor, "*batch k"], *, steps: int = 10
) -> Float[Tensor, "*points 2"]:
    """Inverse of `distort` by Newton's method; differentiable, accurate where the lens model is one to one."""
    plane = distorted
    for _ in range(steps):
        error = distort(plane, coefficients) - distorted
        step = 1e-6
        shift = torch.tensor(((step, 0.0), (0.0, step)), dtype=plane.dtype, device=plane.device)
        columns = [(distort(plane + d, coefficients) - distort(plane - d, coefficients)) / (2 * step) for d in shift]
        jacobian = torch.stack(columns, -1)
        plane = plane - torch.linalg.solve(jacobian, error[..., None]).squeeze(-1)
    return plane


def _tilt(plane: Tensor, tau_x: Tensor, tau_y: Tensor) -> Tensor:
    """Tilted image sensor of OpenCV's fourteen-coefficient model."""
    zero, one = torch.zeros_like(tau_x), torch.ones_like(tau_x)
    cx, sx, cy, sy = tau_x.cos(), tau_x.sin(), tau_y.cos(), tau_y.sin()
    about_x = torch.stack((one, zero, zero, zero, cx, sx, zero, -sx, cx), -1).unflatten(-1, (3, 3))
    about_y = torch.stack((cy, zero, -sy, zero, one, zero, sy, zero, cy), -1).unflatten(-1, (3, 3))
    rotation = about_y @ about_x
    r22, r02, r12 = rotation[..., 2, 2], rotation[..., 0, 2], rotation[..., 1, 2]
    shear = torch.stack((r22, zero, -r02, zero, r22, -r12, zero, zero, one), -1).unflatten(-1, (3, 3))
    homogeneous = torch.cat((plane, torch.ones_like(plane[..., :1])), -1)
    tilted = (shear @ rotation @ homogeneous[..., None]).squeeze(-1)
    return tilted[..., :2] / tilted[..., 2:]
