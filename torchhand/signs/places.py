"""Where fingertips and the thumb's tip are, as seen from the thumb and from the fingers; of right hands."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.geometry import tapered_capsule_depth
from torchhand.hand import CONE_NAMES, FINGERS, Primitives

_THUMB = [CONE_NAMES.index(f"thumb_{bone}") for bone in ("proximal", "distal")]
_PROXIMAL, _MIDDLE, _DISTAL = (
    [CONE_NAMES.index(f"{finger}_{bone}") for finger in FINGERS[1:]] for bone in ("proximal", "middle", "distal")
)


def tips_on_thumb(primitives: Primitives) -> Float[Tensor, "*batch 4"]:
    """How deep the balls at the ends of the fingers, index to little, are in the thumb, metres; minus the gaps."""
    radii = _radii(primitives)
    thumb = (
        primitives.cone_position[..., None, _THUMB, :],
        _ends(primitives)[..., None, _THUMB, :],
        radii[..., _THUMB, :],
    )
    tips = _ends(primitives)[..., _DISTAL, None, :]
    balls = radii[..., _DISTAL, 1:, None].expand(*radii.shape[:-2], len(_DISTAL), 1, 2)
    return tapered_capsule_depth(tips, tips, balls, thumb[0], thumb[1], thumb[2][..., None, :, :]).amax(-1)


def thumb_asides(primitives: Primitives) -> Float[Tensor, "*batch 4"]:
    """How far the thumb's tip is to the thumb's side of the planes in which the fingers bend, metres."""
    return _along(primitives, _PROXIMAL, 2)


def thumb_insides(primitives: Primitives) -> Float[Tensor, "*batch 4"]:
    """How far the thumb's tip is inside the bends of the fingers' PIP joints, index to little, metres.

    The smaller one of its distances to the palmar side of the proximal and of the middle segment's axis.
    """
    return torch.minimum(-_along(primitives, _PROXIMAL, 0), -_along(primitives, _MIDDLE, 0))


def _along(primitives: Primitives, segments: list[int], axis: int) -> Float[Tensor, "*batch 4"]:
    """From the fingers' PIP joints to the middle of the thumb's tip, along an axis of the segments."""
    ends = _ends(primitives)
    way = ends[..., _THUMB[1:], :] - ends[..., _PROXIMAL, :]
    return (way * primitives.cone_rotation[..., segments, :, axis]).sum(-1)


def _ends(primitives: Primitives) -> Float[Tensor, "*batch cones 3"]:
    axes, length = primitives.cone_rotation[..., 1], primitives.sizes.cone_length
    return primitives.cone_position + axes * length[..., None]


def _radii(primitives: Primitives) -> Float[Tensor, "*batch cones 2"]:
    """At both ends of the cones; of the palm's along its smaller half axis."""
    start = primitives.sizes.cone_start[..., 0]
    return torch.stack((start, start * primitives.sizes.cone_end_scale), -1)
