"""Cameras in OpenCV's convention: x right, y down, z forward, the centre of the first pixel is (0, 0)."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from numbers import Integral
from typing import Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.errors import require, require_kind
from torchhand.precision import own_precision

ASSUMED_HORIZONTAL_FOV_DEG = 55.0
DISTORTION_LENGTHS = (0, 4, 5, 8, 12, 14)


@dataclass(frozen=True, kw_only=True)
class Camera:
    """One camera, or a batch of cameras of one picture size.

    Its numbers follow the points that it sees: float32 points are projected in float32.
    """

    intrinsics: Float[Tensor, "*batch 3 3"]
    """K in pixels; of an orthographic camera its diagonal holds pixels per metre."""
    rotation: Float[Tensor, "*batch 3 3"]
    """Rotation cam_from_world."""
    translation: Float[Tensor, "*batch 3"]
    """cam_from_world, metres."""
    distortion: Float[Tensor, "*batch k"]
    """OpenCV's order k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [τx τy]]]]; k is 0, 4, 5, 8, 12 or 14."""
    width: int
    """Width of the picture, px."""
    height: int
    """Height of the picture, px."""
    kind: Literal["pinhole", "orthographic"] = "pinhole"
    name: str = "cam0"
    is_assumed: bool = False
    """True where no calibration was given and a field of view was assumed."""

    def __post_init__(self) -> None:
        """Raises TypeError for what is no tensor, ValueError for other shapes and for pictures without a pixel."""
        for name, size in (("intrinsics", (3, 3)), ("rotation", (3, 3)), ("translation", (3,)), ("distortion", ())):
            value = getattr(self, name)
            require_kind(name, value, Tensor)
            is_so = value.ndim > 0 and value.shape[value.ndim - len(size) :] == size
            require(is_so, name, f"shape (*batch, {', '.join(map(str, size))})", tuple(value.shape))
        for name in ("width", "height"):
            value = getattr(self, name)
            require(isinstance(value, Integral) and int(value) >= 1, name, "a whole number, 1 or more", value)
        if self.distortion.shape[-1] not in DISTORTION_LENGTHS:
            raise ValueError(f"distortion: expected {DISTORTION_LENGTHS} coefficients, got {self.distortion.shape[-1]}")
        if self.kind == "orthographic" and self.has_distortion:
            raise ValueError("distortion: an orthographic camera has none")

    @property
    def has_distortion(self) -> bool:
        """Whether any coefficient is not 0. Where torch compiles it knows no values: whether there are coefficients."""
        if torch.compiler.is_compiling():
            return self.distortion.shape[-1] > 0
        return self._has_distortion

    @property
    def has_skew(self) -> bool:
        """Whether a pixel's column depends on y, or its row on x. Where torch compiles: as if they did."""
        return torch.compiler.is_compiling() or self._has_skew

    @cached_property
    def _has_distortion(self) -> bool:
        return self.distortion.shape[-1] > 0 and bool((self.distortion != 0).any())

    @cached_property
    def _has_skew(self) -> bool:
        return bool((self.intrinsics[..., 0, 1] != 0).any() or (self.intrinsics[..., 1, 0] != 0).any())

    def to(self, *, dtype: torch.dtype | None = None, device: torch.device | str | None = None) -> "Camera":
        """The same camera with its tensors moved."""
        moved = {
            name: getattr(self, name).to(dtype=dtype, device=device)
            for name in ("intrinsics", "rotation", "translation", "distortion")
        }
        return replace(self, **moved)

    def at_origin(self) -> "Camera":
        """The same camera in a world that is its own frame."""
        eye = torch.eye(3, dtype=self.rotation.dtype, device=self.rotation.device)
        return replace(self, rotation=eye, translation=torch.zeros_like(self.translation))

    def rows(self, rows: "Int[Tensor, 'n'] | slice") -> "Camera":
        """Some cameras of a batch with one dimension; itself where there is one camera for all."""
        if self.intrinsics.ndim == 2 or len(self.intrinsics) == 1:
            return self
        names = ("intrinsics", "rotation", "translation", "distortion")
        return replace(self, **{name: getattr(self, name)[rows] for name in names})

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

    def of_part(self, corner: tuple[int, int], part: tuple[int, int], size: tuple[int, int]) -> "Camera":
        """The camera of a part of the picture, resampled to another size; all (x, y), px."""
        to_part = torch.eye(3, dtype=self.intrinsics.dtype, device=self.intrinsics.device)
        for axis in range(2):
            scale = size[axis] / part[axis]
            to_part[axis, axis], to_part[axis, 2] = scale, (0.5 - corner[axis]) * scale - 0.5
        return replace(self, intrinsics=to_part @ self.intrinsics, width=size[0], height=size[1])

    @own_precision
    def cam_from_world(self, points_world: Float[Tensor, "*points 3"]) -> Float[Tensor, "*points 3"]:
        """Points in the camera frame, metres; camera batches broadcast against the leading dimensions of the points."""
        if self.rotation.ndim == 2:
            return points_world @ self.rotation.to(points_world).T + self.translation.to(points_world)
        rotation, translation = _match(self.rotation, 2, points_world), _match(self.translation, 1, points_world)
        return (rotation * points_world[..., None, :]).sum(-1) + translation

    @own_precision
    def pixels_from_plane(self, plane: Float[Tensor, "*points 2"]) -> Float[Tensor, "*points 2"]:
        """Pixels of points of the normalised image plane (x/z, y/z; orthographic: x, y in metres), distorted."""
        distorted = distort(plane, _match(self.distortion, 1, plane)) if self.has_distortion else plane
        (a, b, u), (c, d, v) = self._image_map(plane)
        x, y = distorted.unbind(-1)
        if not self.has_skew:
            return torch.stack((a * x + u, d * y + v), -1)
        return torch.stack((a * x + b * y + u, c * x + d * y + v), -1)

    @own_precision
    def plane_from_pixels(self, points_px: Float[Tensor, "*points 2"]) -> Float[Tensor, "*points 2"]:
        """Points of the normalised image plane that appear at the given pixels; inverse of `pixels_from_plane`."""
        (a, b, u), (c, d, v) = self._image_map(points_px)
        x, y = points_px[..., 0] - u, points_px[..., 1] - v
        if self.has_skew:
            determinant = a * d - b * c
            plane = torch.stack(((d * x - b * y) / determinant, (a * y - c * x) / determinant), -1)
        else:
            plane = torch.stack((x / a, y / d), -1)
        return undistort(plane, _match(self.distortion, 1, plane)) if self.has_distortion else plane

    @own_precision
    def pixel_jacobian(self, plane: Float[Tensor, "*points 2"]) -> Float[Tensor, "*points 2 2"]:
        """Derivative of `pixels_from_plane`: change of (x, y) in pixels, row by row, with the point of the plane."""
        linear = _match(self.intrinsics, 2, plane)[..., :2, :2]
        if not self.has_distortion:
            return linear.expand(*plane.shape[:-1], 2, 2)
        return linear @ distortion_jacobian(plane, _match(self.distortion, 1, plane))

    def _image_map(self, points: Tensor) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
        """First two rows of K, entry by entry."""
        top, bottom, _ = _match(self.intrinsics, 2, points).unbind(-2)
        return top.unbind(-1), bottom.unbind(-1)

    @own_precision
    def plane_from_cam(self, points_cam: Float[Tensor, "*points 3"]) -> Float[Tensor, "*points 2"]:
        """Normalised image plane; depths at or behind the camera give non-finite or mirrored points."""
        return points_cam[..., :2] if self.kind == "orthographic" else points_cam[..., :2] / points_cam[..., 2:]

    @own_precision
    def project(self, points_world: Float[Tensor, "*points 3"]) -> Float[Tensor, "*points 2"]:
        """Pixels of points given in the world frame, metres."""
        return self.pixels_from_plane(self.plane_from_cam(self.cam_from_world(points_world)))

    @own_precision
    def rays(
        self, points_px: Float[Tensor, "*points 2"]
    ) -> tuple[Float[Tensor, "*points 3"], Float[Tensor, "*points 3"]]:
        """Origin and direction in the camera frame of the ray through each pixel; directions have z = 1."""
        plane = self.plane_from_pixels(points_px)
        one, zero = torch.ones_like(plane[..., :1]), torch.zeros_like(plane)
        if self.kind == "orthographic":
            return torch.cat((plane, 0 * one), -1), torch.cat((zero, one), -1)
        return torch.cat((zero, 0 * one), -1), torch.cat((plane, one), -1)


def _match(parameter: Tensor, own: int, points: Tensor) -> Tensor:
    """`parameter` of shape (*batch, own dims) with as many leading dimensions as `points` has, and in their dtype."""
    parameter = parameter.to(points)
    batch = parameter.shape[: parameter.ndim - own]
    missing = points.ndim - 1 - len(batch)
    return (
        parameter.reshape(*batch, *(1,) * missing, *parameter.shape[len(batch) :])
        if missing > 0 and batch
        else parameter
    )


def assumed_camera(
    width: int,
    height: int,
    *,
    horizontal_fov_deg: float = ASSUMED_HORIZONTAL_FOV_DEG,
    dtype: torch.dtype = torch.float64,
) -> Camera:
    """An ideal pinhole camera at the world's origin for pictures without calibration; marked as assumed.

    width, height: of the pictures, px. Raises ValueError for less than a pixel, and for a field of view that is not
    1° to 170°.
    """
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


@own_precision
def distort(plane: Float[Tensor, "*points 2"], coefficients: Float[Tensor, "*batch k"]) -> Float[Tensor, "*points 2"]:
    """OpenCV's lens model (rational, tangential, thin prism, tilted sensor) on the normalised image plane."""
    k = _padded(coefficients)
    x, y = plane.unbind(-1)
    r2 = x * x + y * y
    radial = (1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))) / (1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7])))
    xd = x * radial + 2 * k[2] * x * y + k[3] * (r2 + 2 * x * x) + r2 * (k[8] + r2 * k[9])
    yd = y * radial + k[2] * (r2 + 2 * y * y) + 2 * k[3] * x * y + r2 * (k[10] + r2 * k[11])
    distorted = torch.stack((xd, yd), -1)
    if coefficients.shape[-1] < 14:
        return distorted
    tilted = _seen_on_tilted_sensor(distorted, k[12], k[13])
    return tilted[..., :2] / tilted[..., 2:]


@own_precision
def distortion_jacobian(
    plane: Float[Tensor, "*points 2"], coefficients: Float[Tensor, "*batch k"]
) -> Float[Tensor, "*points 2 2"]:
    """Derivative of `distort` with the point of the plane."""
    k = _padded(coefficients)
    x, y = plane.unbind(-1)
    r2 = x * x + y * y
    above, below = 1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4])), 1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
    above_r2, below_r2 = k[0] + r2 * (2 * k[1] + 3 * r2 * k[4]), k[5] + r2 * (2 * k[6] + 3 * r2 * k[7])
    radial = above / below
    radial_r2 = (above_r2 - radial * below_r2) / below
    # With r2: x radial + prism; its own derivatives with x and y are 2x and 2y.
    x_r2, y_r2 = x * radial_r2 + k[8] + 2 * k[9] * r2, y * radial_r2 + k[10] + 2 * k[11] * r2
    across = 2 * (k[2] * x + k[3] * y)
    xx = radial + 2 * x * x_r2 + 2 * k[2] * y + 6 * k[3] * x
    yy = radial + 2 * y * y_r2 + 6 * k[2] * y + 2 * k[3] * x
    jacobian = torch.stack((xx, 2 * y * x_r2 + across, 2 * x * y_r2 + across, yy), -1).unflatten(-1, (2, 2))
    if coefficients.shape[-1] < 14:
        return jacobian
    flat = coefficients.clone()
    flat[..., 12:] = 0
    tilted = _seen_on_tilted_sensor(distort(plane, flat), k[12], k[13])
    homography = _tilt(k[12], k[13])
    seen = tilted[..., :2, None] / tilted[..., 2:, None]
    perspective = (homography[..., :2, :2] - seen * homography[..., 2:, :2]) / tilted[..., 2:, None]
    return perspective @ jacobian


@own_precision
def undistort(
    distorted: Float[Tensor, "*points 2"], coefficients: Float[Tensor, "*batch k"], *, steps: int = 10
) -> Float[Tensor, "*points 2"]:
    """Inverse of `distort` by Newton's method; differentiable, accurate where the lens model is one to one."""
    plane = distorted
    for _ in range(steps):
        x, y = (distort(plane, coefficients) - distorted).unbind(-1)
        (a, b), (c, d) = (row.unbind(-1) for row in distortion_jacobian(plane, coefficients).unbind(-2))
        plane = plane - torch.stack((d * x - b * y, a * y - c * x), -1) / (a * d - b * c)[..., None]
    return plane


def _padded(coefficients: Tensor) -> list[Tensor]:
    k = list(coefficients.unbind(-1))
    return k + [torch.zeros_like(coefficients[..., 0])] * (14 - len(k))


def _seen_on_tilted_sensor(plane: Tensor, tau_x: Tensor, tau_y: Tensor) -> Tensor:
    """Homogeneous points on the tilted sensor of OpenCV's fourteen-coefficient model."""
    homogeneous = torch.cat((plane, torch.ones_like(plane[..., :1])), -1)
    return (_tilt(tau_x, tau_y) @ homogeneous[..., None]).squeeze(-1)


def _tilt(tau_x: Tensor, tau_y: Tensor) -> Tensor:
    """Homography of the tilted sensor."""
    zero, one = torch.zeros_like(tau_x), torch.ones_like(tau_x)
    cx, sx, cy, sy = tau_x.cos(), tau_x.sin(), tau_y.cos(), tau_y.sin()
    about_x = torch.stack((one, zero, zero, zero, cx, sx, zero, -sx, cx), -1).unflatten(-1, (3, 3))
    about_y = torch.stack((cy, zero, -sy, zero, one, zero, sy, zero, cy), -1).unflatten(-1, (3, 3))
    rotation = about_y @ about_x
    r22, r02, r12 = rotation[..., 2, 2], rotation[..., 0, 2], rotation[..., 1, 2]
    shear = torch.stack((r22, zero, -r02, zero, r22, -r12, zero, zero, one), -1).unflatten(-1, (3, 3))
    return shear @ rotation
