"""The skeleton of one person's hand of one side: what formats that store a skeleton as it stands take."""

from dataclasses import replace

from jaxtyping import Float
from torch import Tensor

from torchhand.hand.kinematics.kinematics import Side, mirrored
from torchhand.hand.kinematics.shape import ShapeSpace, bone_offsets
from torchhand.hand.kinematics.skeleton import Skeleton


def sided_skeleton(
    skeleton: Skeleton, side: Side, *, space: ShapeSpace | None = None, shape: Float[Tensor, "shape"] | None = None
) -> Skeleton:
    """The right hand's skeleton with the offsets of a shape (the default ones without), mirrored for a left hand."""
    own = skeleton
    if shape is not None and space is not None:
        offsets, tips = bone_offsets(space.to(dtype=shape.dtype), shape, skeleton.rest_rotation[1:6].to(shape))
        own = replace(own, rest_offset=offsets.to(own.axis), tip_offset=tips.to(own.axis))
    return own if side == "right" else mirrored(own)
