"""What a network sees of 21 points in a picture: the same numbers for the same hand, whatever the camera."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.hand import KEYPOINTS, PALM

FEATURES = 3 * len(KEYPOINTS) + 1
"""Two coordinates and a flag for every point, and the logarithm of the hand's angular size."""
MIN_SEEN = 6
"""Fewer points do not say how large a hand is in the picture and where it is."""

_USUAL_SIZE = 0.1  # of the seen points on the image plane; makes its logarithm small
_SMALLEST_SIZE = 1e-4
_AHEAD = 1e-2  # smallest depth in the view of a point whose ray has z = 1


@dataclass(frozen=True, kw_only=True)
class Observation:
    """Points as a camera would see them that looks straight at the middle of the hand and holds it upright."""

    features: Float[Tensor, "*batch 64"]
    centre: Float[Tensor, "*batch 2"]
    """Mean of the seen points on the image plane of the view."""
    size: Float[Tensor, "*batch"]
    """Root mean square distance of the seen points from it, on the same plane: about the angle, radians."""
    cam_from_view: Float[Tensor, "*batch 3 3"]


def observe(points_plane: Float[Tensor, "*batch 21 2"], seen: Bool[Tensor, "*batch 21"]) -> Observation:
    """Turn the camera (exactly, it is a rotation about its centre) and take out centre and size.

    points_plane: on the normalised image plane (`Camera.plane_from_pixels`), so that focal length and principal point
    are gone; those of unseen points are ignored and may be NaN. The view looks at the mean of the seen points, and is
    turned about its axis until the knuckles stand above the wrist; where wrist or knuckles are not seen, it is not.
    A hand with fewer than MIN_SEEN seen points gets numbers, but no sense.
    """
    points = torch.where(seen[..., None], points_plane, 0.0)
    weight = seen.to(points)
    ahead = torch.cat((_mean(points, weight), torch.ones_like(points[..., 0, :1])), -1)
    view_from_cam = _looking_at(ahead)
    turned = _seen_from(view_from_cam, points)
    wrist, *knuckles = PALM
    up = _mean(turned[..., knuckles, :], weight[..., knuckles]) - turned[..., wrist, :]
    is_known = seen[..., wrist] & seen[..., knuckles].any(-1) & (up.norm(dim=-1) > _SMALLEST_SIZE)
    view_from_cam = _upright(torch.where(is_known[..., None], up, up.new_tensor((0.0, -1.0)))) @ view_from_cam
    turned = _seen_from(view_from_cam, points)
    centre = _mean(turned, weight)
    arms = torch.where(seen[..., None], turned - centre[..., None, :], 0.0)
    size = (arms.square().sum((-1, -2)) / weight.sum(-1).clamp_min(1)).sqrt().clamp_min(_SMALLEST_SIZE)
    scaled = (arms / size[..., None, None]).flatten(-2)
    return Observation(
        features=torch.cat((scaled, weight, (size / _USUAL_SIZE).log()[..., None]), -1),
        centre=centre,
        size=size,
        cam_from_view=view_from_cam.mT,
    )


def mirrored(points_plane: Float[Tensor, "*batch 21 2"]) -> Float[Tensor, "*batch 21 2"]:
    """The points of a left hand as those of the right hand that is its mirror image in the plane x = 0."""
    return points_plane * points_plane.new_tensor((-1.0, 1.0))


def _mean(points: Float[Tensor, "*batch n 2"], weight: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch 2"]:
    return (points * weight[..., None]).sum(-2) / weight.sum(-1, keepdim=True).clamp_min(1)


def _looking_at(ahead: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    """view_from_cam of a camera whose axis is `ahead` and whose x axis stays level."""
    forward = torch.nn.functional.normalize(ahead, dim=-1)
    down = forward.new_tensor((0.0, 1.0, 0.0)).expand_as(forward)
    right = torch.nn.functional.normalize(torch.linalg.cross(down, forward), dim=-1)
    return torch.stack((right, torch.linalg.cross(forward, right), forward), -2)


def _upright(up: Float[Tensor, "*batch 2"]) -> Float[Tensor, "*batch 3 3"]:
    """Rotation about the optical axis that turns a direction of the picture upwards, to -y."""
    x, y = torch.nn.functional.normalize(up, dim=-1).unbind(-1)
    zero, one = torch.zeros_like(x), torch.ones_like(x)
    return torch.stack((-y, x, zero, -x, -y, zero, zero, zero, one), -1).unflatten(-1, (3, 3))


def _seen_from(view_from_cam: Float[Tensor, "*batch 3 3"], points: Tensor) -> Float[Tensor, "*batch 21 2"]:
    rays = torch.cat((points, torch.ones_like(points[..., :1])), -1) @ view_from_cam.mT
    return rays[..., :2] / rays[..., 2:].clamp_min(_AHEAD)
