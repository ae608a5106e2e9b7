"""How far each bone has turned since a rest posture, in axes that all bones share: what most file formats store.

BVH, H-Anim and MANO know no resting rotation of a joint: at rest the frames of all bones are parallel to the hand
frame, and a joint's rotation is its turn relative to its parent since then.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.hand.kinematics import PARENTS
from torchhand.precision import own_precision


@own_precision
def bone_turns(
    rotation: Float[Tensor, "*batch 20 3 3"], rest: Float[Tensor, "20 3 3"]
) -> Float[Tensor, "*batch 20 3 3"]:
    """Turn of each bone relative to its parent; the first is the wrist's own in the world.

    rotation: world_from_bone. rest: hand_from_bone at the rest posture.
    """
    since = turns_in_world(rotation, rest)
    relative = since[..., list(PARENTS[1:]), :, :].mT @ since[..., 1:, :, :]
    return torch.cat((since[..., :1, :, :], relative), -3)


def turns_in_world(
    rotation: Float[Tensor, "*batch 20 3 3"], rest: Float[Tensor, "20 3 3"]
) -> Float[Tensor, "*batch 20 3 3"]:
    """Turn of each bone in the world: world_from_bone · bone_from_hand at rest."""
    return rotation @ rest.mT


@own_precision
def bone_rotations(
    turns: Float[Tensor, "*batch 20 3 3"], rest: Float[Tensor, "20 3 3"]
) -> Float[Tensor, "*batch 20 3 3"]:
    """world_from_bone of the turns: the inverse of `bone_turns`."""
    since = [turns[..., 0, :, :]]
    for bone in range(1, len(PARENTS)):
        since.append(since[PARENTS[bone]] @ turns[..., bone, :, :])
    return torch.stack(since, -3) @ rest
