"""The cube that an octree divides, and the volume that cameras see together."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.geometry import Camera

NEAREST, FARTHEST = 0.05, 2.0  # metres

_WITHIN = 1e-7  # a corner of the common volume may break its planes by this much, m
_FLAT = 1e-9  # three planes with a smaller determinant of their unit normals do not meet in a point
_AT_ONCE = 1 << 24


@dataclass(frozen=True, kw_only=True)
class RootCube:
    """An axis-aligned cube in the world frame."""

    centre: tuple[float, float, float]
    """Centre of the cube, metres."""
    side: float
    """Side of the cube, metres."""

    def __post_init__(self) -> None:
        if not 0 < self.side < float("inf"):
            raise ValueError(f"side: expected a positive length in metres, got {self.side}")
        if not torch.tensor(self.centre).isfinite().all():
            raise ValueError(f"centre: expected finite metres, got {self.centre}")

    @property
    def corner(self) -> tuple[float, float, float]:
        """The corner of least x, y and z."""
        x, y, z = self.centre
        return x - 0.5 * self.side, y - 0.5 * self.side, z - 0.5 * self.side


def root_cube(cameras: Sequence[Camera], *, nearest: float = NEAREST, farthest: float = FARTHEST) -> RootCube:
    """The smallest cube around the box of the volume that all cameras see; arguments and errors as `common_volume`."""
    corners = common_volume(cameras, nearest=nearest, farthest=farthest)
    low, high = corners.amin(0), corners.amax(0)
    x, y, z = (0.5 * (low + high)).tolist()
    return RootCube(centre=(x, y, z), side=float((high - low).max()))


def common_volume(
    cameras: Sequence[Camera], *, nearest: float = NEAREST, farthest: float = FARTHEST
) -> Float[Tensor, "corners 3"]:
    """Corners (world frame, float64) of the convex volume that lies in the pictures of all cameras.

    nearest, farthest: depths in every camera between which it is looked for, in the unit of the cameras' translations;
        two cameras that look the same way see together what is far away, so that something has to end it.
    A distorted picture counts as the rectangle around it on the image plane.

    Raises ValueError for no cameras, for depths in the wrong order, and where the cameras see no volume together; the
    message names two that share none, if there are two.
    """
    if not cameras:
        raise ValueError("cameras: expected at least one, got none")
    if not 0 < nearest < farthest:
        raise ValueError(f"nearest, farthest: expected 0 < nearest < farthest, got {nearest} and {farthest}")
    planes = [_planes(camera, nearest, farthest) for camera in cameras]
    corners = _corners(torch.cat(planes))
    if len(corners) >= 4:
        return corners
    reason = next(
        (
            f"{one.name!r} and {other.name!r} share none"
            for (one, its), (other, theirs) in combinations(zip(cameras, planes, strict=True), 2)
            if len(_corners(torch.cat((its, theirs)))) < 4
        ),
        "every two of them share some",
    )
    names = ", ".join(camera.name for camera in cameras)
    raise ValueError(
        f"cameras: no volume is seen by all of {names} at depths of {nearest:g} to {farthest:g} ({reason}); expected"
        " cameras that look at one place: check the unit of t and that R and t turn the world into the camera"
    )


def _planes(camera: Camera, nearest: float, farthest: float) -> Float[Tensor, "planes 4"]:
    """Planes (n, d) around what the camera sees, n·X + d >= 0 inside, |n| = 1."""
    camera = camera.to(dtype=torch.float64, device="cpu")
    if camera.rotation.ndim != 2:
        raise ValueError(f"cameras: expected single cameras, got a batch {tuple(camera.rotation.shape[:-2])}")
    x, y = (torch.linspace(-0.5, n - 0.5, 33, dtype=torch.float64) for n in (camera.width, camera.height))
    rows = [torch.stack((x, torch.full_like(x, float(end))), -1) for end in (y[0], y[-1])]
    columns = [torch.stack((torch.full_like(y, float(end)), y), -1) for end in (x[0], x[-1])]
    border = camera.plane_from_pixels(torch.cat(rows + columns))
    (left, top), (right, bottom) = border.amin(0).tolist(), border.amax(0).tolist()
    if camera.kind == "orthographic":
        sides = [(1, 0, 0, -left), (-1, 0, 0, right), (0, 1, 0, -top), (0, -1, 0, bottom)]
    else:
        sides = [(1, 0, -left, 0), (-1, 0, right, 0), (0, 1, -top, 0), (0, -1, bottom, 0)]
    in_cam = torch.tensor([*sides, (0, 0, 1, -nearest), (0, 0, -1, farthest)], dtype=torch.float64)
    in_cam = in_cam / in_cam[:, :3].norm(dim=-1, keepdim=True)
    offset = in_cam[:, 3] + in_cam[:, :3] @ camera.translation
    return torch.cat((in_cam[:, :3] @ camera.rotation, offset[:, None]), -1)


def _corners(planes: Float[Tensor, "planes 4"]) -> Float[Tensor, "corners 3"]:
    """Points where three planes meet that lie on the inner side of all."""
    triples = torch.combinations(torch.arange(len(planes)), 3)
    found = []
    for some in triples.split(max(1, _AT_ONCE // len(planes))):
        a, b, c = planes[some, :3].unbind(1)
        ab, bc, ca = torch.linalg.cross(a, b), torch.linalg.cross(b, c), torch.linalg.cross(c, a)
        determinant = (a * bc).sum(-1)
        meets = determinant.abs() > _FLAT
        d = planes[some, 3][meets]
        point = -(d[:, :1] * bc[meets] + d[:, 1:2] * ca[meets] + d[:, 2:] * ab[meets]) / determinant[meets, None]
        is_inside = (point @ planes[:, :3].T + planes[:, 3] >= -_WITHIN).all(-1)
        found.append(point[is_inside])
    return torch.cat(found)
