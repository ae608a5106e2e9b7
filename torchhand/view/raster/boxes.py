"""Where each primitive lies in the picture: exact bounding boxes in closed form."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.geometry import Camera
from torchhand.hand import CONE_NAMES, Primitives

_CONES = len(CONE_NAMES)
_EDGE_POINTS = 48  # of a box, when it has to be carried through lens distortion
_EVERYWHERE = 1e6


def plane_boxes(primitives_cam: Primitives, *, is_orthographic: bool = False) -> Float[Tensor, "37 4"]:
    """Smallest x, y and largest x, y of every primitive of one hand on the normalised image plane.

    A truncated cone is the convex hull of its two end discs, and a disc is an ellipsoid of no height. An ellipsoid has
    the dual conic C* = R diag(axes²) Rᵀ - p pᵀ, whose tangents x = u solve C*₁₁ - 2 u C*₁₃ + u² C*₃₃ = 0. A half
    ellipsoid gets the box of the whole one. What reaches the plane of the camera's centre is unbounded.
    """
    s = primitives_cam.sizes
    zero = torch.zeros_like(s.cone_length)
    start = torch.stack((s.cone_start[:, 0], zero, s.cone_start[:, 1]), -1)
    tops = primitives_cam.cone_position + primitives_cam.cone_rotation[..., 1] * s.cone_length[:, None]
    axes = torch.cat((start, start * s.cone_end_scale[:, None], s.ellipsoid_axes))
    centre = torch.cat((primitives_cam.cone_position, tops, primitives_cam.ellipsoid_position))
    turned = torch.cat((primitives_cam.cone_rotation, primitives_cam.cone_rotation, primitives_cam.ellipsoid_rotation))
    spread = turned * axes[:, None]
    spread = spread @ spread.transpose(-1, -2)
    if is_orthographic:
        half = spread.diagonal(dim1=-2, dim2=-1)[:, :2].sqrt()
        boxes = torch.cat((centre[:, :2] - half, centre[:, :2] + half), -1)
    else:
        dual = spread - centre[:, :, None] * centre[:, None, :]
        depth, mixed, flat = dual[:, 2, 2, None], dual[:, :2, 2], dual.diagonal(dim1=-2, dim2=-1)[:, :2]
        half = (mixed * mixed - depth * flat).clamp_min(0).sqrt()
        boxes = torch.cat(((mixed + half) / depth, (mixed - half) / depth), -1)  # depth is negative
        is_ahead = (centre[:, 2:] > 0) & (depth < -1e-9)
        limits = torch.tensor(
            (-_EVERYWHERE, -_EVERYWHERE, _EVERYWHERE, _EVERYWHERE), dtype=boxes.dtype, device=boxes.device
        )
        boxes = torch.where(is_ahead, boxes, limits)
    starts, ends, balls = boxes.split((_CONES, _CONES, len(boxes) - 2 * _CONES))
    cones = torch.cat((torch.minimum(starts[:, :2], ends[:, :2]), torch.maximum(starts[:, 2:], ends[:, 2:])), -1)
    return torch.cat((cones, balls))


def pixel_boxes(primitives_cam: Primitives, camera: Camera) -> list[tuple[int, int, int, int]]:
    """x0, y0, x1, y1 (exclusive) of every primitive of one hand, cut to the picture.

    A primitive outside the picture has x1 <= x0 or y1 <= y0.
    """
    boxes = plane_boxes(primitives_cam, is_orthographic=camera.kind == "orthographic")
    low, high = boxes[:, None, :2], boxes[:, None, 2:]
    outline = square_outline(_EDGE_POINTS if camera.has_distortion else 1, boxes)
    pixels = camera.pixels_from_plane(low + outline * (high - low))
    margin = 2 if camera.has_distortion else 1
    size = torch.tensor((camera.width, camera.height), dtype=boxes.dtype, device=boxes.device)
    first = (pixels.amin(1).floor() - margin).clamp_min(0)
    last = torch.minimum(pixels.amax(1).ceil() + margin + 1, size)
    is_bounded = (boxes.abs() < _EVERYWHERE).all(-1, keepdim=True)
    if camera.has_distortion:  # far outside the picture the lens model means nothing
        is_bounded = is_bounded & (boxes.abs() < 4 * _reach(camera)).all(-1, keepdim=True)
    first = torch.where(is_bounded, first, torch.zeros_like(first))
    last = torch.where(is_bounded, last, size)
    return [(int(x0), int(y0), int(x1), int(y1)) for x0, y0, x1, y1 in torch.cat((first, last), -1).tolist()]


def square_outline(steps: int, like: Tensor) -> Float[Tensor, "points 2"]:
    """Points around the unit square, `steps` to a side."""
    t = torch.arange(steps, dtype=like.dtype, device=like.device) / steps
    zero, one = torch.zeros_like(t), torch.ones_like(t)
    sides = ((t, zero), (one, t), (1 - t, one), (zero, 1 - t))
    return torch.cat([torch.stack(side, -1) for side in sides])


def _reach(camera: Camera) -> float:
    """Half the picture on the normalised plane."""
    focal = torch.stack((camera.intrinsics[..., 0, 0], camera.intrinsics[..., 1, 1])).amin()
    return float(0.5 * max(camera.width, camera.height) / focal)
