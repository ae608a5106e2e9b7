"""Hypotheses for a picture that the prediction does not explain: the hand elsewhere, turned, or with other fingers."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.geometry import Camera, rotation_from_vector
from torchhand.hand import DOFS, FINGERS, posture
from torchhand.image import depth_map

_ROOT = 6
_TURNS = 24  # directions all around
_LEAST_SCALE, _MOST_SCALE = 0.7, 1.4  # of the hand's distance from one picture to the next
_BENT = 0.6  # of a fist


@dataclass(frozen=True, kw_only=True)
class Starts:
    """Where registrations begin."""

    pose: Float[Tensor, "starts 36"]
    """Metres and radians, the rotation vector on top of the reference."""
    root_reference: Float[Tensor, "starts 3 3"]
    """cam_from_hand"""


def other_postures(
    pose: Float[Tensor, "36"], start: Float[Tensor, "36"], names: tuple[str, ...]
) -> Float[Tensor, "starts 36"]:
    """The posture of the track's start and the named ones, the root left as in `pose`."""
    postures = (start, *(posture(name) for name in names))
    return torch.stack([torch.cat((pose[:_ROOT], angles[_ROOT:].to(pose))) for angles in postures])


def other_fingers(pose: Float[Tensor, "36"], start: Float[Tensor, "36"]) -> Float[Tensor, "10 36"]:
    """Every finger by itself as at the track's start, and bent; all else as in `pose`."""
    bent, starts = posture("fist").to(pose), []
    for finger in FINGERS:
        own = torch.tensor([name.startswith(finger) for name in DOFS], device=pose.device)
        starts += [torch.where(own, start, pose), torch.where(own, _BENT * bent, pose)]
    return torch.stack(starts)


def turned_hands(
    pose: Float[Tensor, "36"],
    root_reference: Float[Tensor, "3 3"],
    model: Bool[Tensor, "height width"],
    mask: Bool[Tensor, "height width"],
    camera: Camera,
) -> Starts | None:
    """The same hand with its palm on the picture's, turned in the picture to directions all around.

    model: silhouette of the hand as it is. The palm is the largest disc that fits into a silhouette, and its size gives
    the distance. None where one of the silhouettes is empty. The camera is the world.
    """
    own_disc, seen_disc = _largest_disc(model), _largest_disc(mask)
    if own_disc is None or seen_disc is None:
        return None
    (own_px, own_radius), (seen_px, seen_radius) = own_disc, seen_disc
    is_orthographic = camera.kind == "orthographic"
    depth = float(pose[2])
    scale = 1.0 if is_orthographic else min(max(own_radius / seen_radius, _LEAST_SCALE), _MOST_SCALE)
    lifted = [1.0, 1.0] if is_orthographic else [depth, scale * depth]
    own, seen = (
        torch.cat((camera.plane_from_pixels(point.to(pose)) * at, pose.new_tensor([z])))
        for point, at, z in zip((own_px, seen_px), lifted, (depth, scale * depth), strict=True)
    )
    angle = torch.arange(_TURNS).to(pose) * (2 * math.pi / _TURNS)
    turn = rotation_from_vector(angle[:, None] * pose.new_tensor([0.0, 0.0, 1.0]))
    turned = pose.expand(_TURNS, -1).clone()
    turned[:, :3] = (turn @ (pose[:3] - own)) + seen
    turned[:, 3:_ROOT] = 0.0
    reference = turn @ rotation_from_vector(pose[3:_ROOT]) @ root_reference
    return Starts(pose=turned, root_reference=reference)


def _largest_disc(mask: Bool[Tensor, "height width"]) -> tuple[Float[Tensor, "2"], float] | None:
    """Centre (x, y) and radius, px, of the largest disc inside a mask."""
    inscribed = depth_map(mask, is_border_outside=True)
    y, x = divmod(int(inscribed.argmax()), mask.shape[1])
    radius = float(inscribed[y, x])
    return (torch.tensor((float(x), float(y)), dtype=torch.float64), radius) if radius > 0 else None
