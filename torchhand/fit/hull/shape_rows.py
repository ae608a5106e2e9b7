"""Derivatives of points of the skin in the shape, in closed form."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.fit import PosedHands
from torchhand.fit.hull.skin import PosedBones, SkinPoints, bones_of


@dataclass(frozen=True, kw_only=True)
class _ShapeMotion:
    """How posed hands follow the shared unknowns."""

    metres: Float[Tensor, "shape c"]
    """Derivative of the parameters in metres."""
    offsets: Float[Tensor, "k 20 3 c"]
    """Derivative, in the world, of what each bone adds to a vertex beside the vertex's own place at the bind pose."""
    breadth: Float[Tensor, "c"]
    """Relative derivative of the hand's breadth, with which the correctives grow."""


def shape_rows(
    skin: SkinPoints,
    hands: PosedHands,
    vertices: Int[Tensor, "k points"],
    direction: Float[Tensor, "k points 3"],
) -> Float[Tensor, "k points c"]:
    """Derivative of direction · vertex in the shared unknowns of posed hands, the poses and directions held.

    skin: of the hands' shape. Unknowns after the shape have no effect.

    With the pose held the bones' rotations do not depend on the shape; their origins, the vertices at the bind pose and
    the correctives are linear in the parameters in metres.
    """
    assert hands.unknowns is not None
    skinning, bones = skin.hand.skinning, bones_of(skin, hands)
    motion = hands.once(("shape motion", id(skin)), lambda: _shape_motion(skin, bones, hands))
    weights = skinning.weights[:, vertices].movedim(1, 0)  # k 20 points
    force = direction.mT[:, None]
    at_bind = (bones.rotation @ skinning.bone_from_hand).mT @ force  # k 20 3 points
    local = (weights[:, :, None] * at_bind).sum(1)
    of_metres = torch.einsum("kjp,jkps->kps", local, skinning.rest_basis[:, vertices])
    pull = (weights[:, :, None] * force).flatten(1, 2).mT  # k points 60
    bent = torch.einsum(
        "kcis,cskp,kpi->kp", bones.bending, skinning.correctives.flatten(1, 2)[..., vertices], direction
    )
    found = of_metres @ motion.metres + pull @ motion.offsets.flatten(1, 2) + bent[..., None] * motion.breadth
    return torch.nn.functional.pad(found, (0, len(hands.unknowns.extra)))


def _shape_motion(skin: SkinPoints, bones: PosedBones, hands: PosedHands) -> _ShapeMotion:
    """Motion of the points with the shape, by differences, which are exact: all is linear in any one parameter."""
    assert hands.unknowns is not None
    columns, kinematics, skinning = list(hands.unknowns.columns), skin.hand.kinematics, skin.hand.skinning
    step = kinematics.shape_space.std.to(skin.shape)[columns]
    shapes = skin.shape.repeat(len(columns), 1)
    shapes[torch.arange(len(columns)), columns] += step
    metres = kinematics.metres(skin.shape)
    of_metres = (kinematics.metres(shapes) - metres).T / step
    pose = hands.pose.to(skin.shape)
    wide = (len(pose), len(columns))
    moved = kinematics(
        pose.dofs[:, None].expand(*wide, -1), shapes.expand(*wide, -1), root_reference=pose.reference[:, None]
    )
    of_origins = (moved.position - bones.position[:, None]).movedim(1, -1) / step  # k 20 3 c
    return _ShapeMotion(
        metres=of_metres,
        offsets=of_origins - bones.rotation @ (skinning.origin_basis @ of_metres),
        breadth=(skinning.breadth_scale @ of_metres) / (skinning.breadth_scale @ metres),
    )
