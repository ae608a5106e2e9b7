"""Proposals for a picture that the prediction does not explain: the hand elsewhere, turned, or with other fingers."""

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.geometry import Camera, rotation_from_vector
from torchhand.hand import DOFS, FINGERS, HandPose, posture
from torchhand.image import depth_map

_ROOT = 6
_TURNS = 24  # directions all around
_MIN_SCALE, _MAX_SCALE = 0.7, 1.4  # of the hand's distance from one picture to the next
_BENT = 0.6  # of a fist


def posture_proposals(hand: HandPose, start: Float[Tensor, "36"], names: tuple[str, ...]) -> HandPose:
    """The posture of the track's start and the named ones (1 + names), the root left as it is."""
    postures = (start, *(posture(name, dtype=torch.float64) for name in names))
    dofs = torch.stack([torch.cat((hand.dofs[:_ROOT], angles[_ROOT:].to(hand.dofs))) for angles in postures])
    return HandPose.of(dofs, hand.reference)


def finger_proposals(hand: HandPose, start: Float[Tensor, "36"]) -> HandPose:
    """Every finger by itself as at the track's start, and bent (10); all else as it is."""
    bent, dofs = posture("fist", dtype=torch.float64).to(hand.dofs), []
    for finger in FINGERS:
        own = torch.tensor([name.startswith(finger) for name in DOFS], device=bent.device)
        dofs += [torch.where(own, start, hand.dofs), torch.where(own, _BENT * bent, hand.dofs)]
    return HandPose.of(torch.stack(dofs), hand.reference)


def turned_proposals(
    hand: HandPose,
    model: Bool[Tensor, "height width"],
    mask: Bool[Tensor, "height width"],
    camera: Camera,
) -> HandPose | None:
    """The same hand with its palm on the picture's, turned in the picture to 24 directions all around.

    model: silhouette of the hand as it is. The palm is the largest disc that fits into a silhouette, and its size gives
    the distance. None where one of the silhouettes is empty. The camera is the world.
    """
    own_disc, seen_disc = _largest_disc(model), _largest_disc(mask)
    if own_disc is None or seen_disc is None:
        return None
    (own_px, own_radius), (seen_px, seen_radius) = own_disc, seen_disc
    is_orthographic, dofs = camera.kind == "orthographic", hand.dofs
    depth = float(dofs[2])
    scale = 1.0 if is_orthographic else min(max(own_radius / seen_radius, _MIN_SCALE), _MAX_SCALE)
    lifted = [1.0, 1.0] if is_orthographic else [depth, scale * depth]
    own, seen = (
        torch.cat((camera.plane_from_pixels(point.to(dofs)) * at, dofs.new_tensor([z])))
        for point, at, z in zip((own_px, seen_px), lifted, (depth, scale * depth), strict=True)
    )
    angle = torch.arange(_TURNS).to(dofs) * (2 * math.pi / _TURNS)
    turn = rotation_from_vector(angle[:, None] * dofs.new_tensor([0.0, 0.0, 1.0]))
    turned = dofs.expand(_TURNS, -1).clone()
    turned[:, :3] = (turn @ (dofs[:3] - own)) + seen
    turned[:, 3:_ROOT] = 0.0
    return HandPose.of(turned, turn @ hand.rotation)


def _largest_disc(mask: Bool[Tensor, "height width"]) -> tuple[Float[Tensor, "2"], float] | None:
    """Centre (x, y) and radius, px, of the largest disc inside a mask."""
    inscribed = depth_map(mask, is_border_outside=True)
    y, x = divmod(int(inscribed.argmax()), mask.shape[1])
    radius = float(inscribed[y, x])
    return (torch.tensor((float(x), float(y)), dtype=torch.float64), radius) if radius > 0 else None
