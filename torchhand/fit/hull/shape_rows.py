"""Derivatives in the shape: of points of the skin, and of what is known of people's proportions."""

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.hand import Anthropometry, Hand


def shape_rows(
    hand: Hand,
    pose: Float[Tensor, "36"],
    root_reference: Float[Tensor, "3 3"],
    shape: Float[Tensor, "shape"],
    vertices: Int[Tensor, "points"],
    direction: Float[Tensor, "points 3"],
    step: Float[Tensor, "shape"],
) -> Float[Tensor, "points shape"]:
    """Derivative of direction · vertex in every shape parameter times its step, the pose held.

    With the pose held a vertex is linear in any one parameter, so that the difference over the step is the derivative
    times it, exactly: bones' rotations do not depend on the shape, their origins and the vertices within them are
    linear in the parameters in metres, and these in each parameter.
    """
    shapes = torch.cat((shape[None], shape + torch.diag(step)))
    count = len(shapes)
    frames = hand.kinematics(pose.expand(count, -1), shapes, root_reference=root_reference.expand(count, 3, 3))
    rotation = frames.rotation[0]
    metres = hand.kinematics.metres(shapes).T
    places, weights, correctives = hand.skinning.loads_at(vertices[:, None], metres)
    features, _ = hand.skinning.corrective_features(pose[:, None].expand(-1, count), metres)
    local = rotation.mT @ direction.T  # 20 3 points
    along = torch.einsum("bjp,bjpn->pn", local, places)
    along = along + torch.einsum("bp,pk,nbk->pn", weights[..., 0], direction, frames.position)
    bent = local.index_select(0, hand.skinning.corrective_bones)
    along = along + torch.einsum("cjp,cfjp,cfn->pn", bent, correctives[..., 0], features)
    return along[:, 1:] - along[:, :1]


def people_rows(
    people: Anthropometry, shape: Float[Tensor, "shape"]
) -> tuple[Float[Tensor, "rows"], Float[Tensor, "rows shape"]]:
    """What is known of people's hands as residuals in standard deviations, and their derivative in the parameters over
    their spreads: the normal distribution over people, and the constraints beyond the bounds, where they are broken."""
    space, count = people.space, len(people.space.names)
    std = space.std.to(shape)
    scaled = (shape - space.default.to(shape)) / std
    length, breadth = (space.names.index(name) for name in ("hand_length", "hand_breadth"))
    rho = people.settings.length_breadth_correlation
    rows = torch.eye(count, dtype=shape.dtype, device=shape.device)
    rows[breadth] /= math.sqrt(1 - rho * rho)
    rows[breadth, length] = -rho / math.sqrt(1 - rho * rho)
    matrix, bound = (x[2 * count :].to(shape) for x in (people.matrix, people.bound))
    spread = people.spread.to(shape).clone()
    spread[-1] *= float(space.default[length])
    scale = people.settings.softness * torch.cat((spread, spread))
    excess = (matrix @ shape - bound) / scale
    of_excess = (excess > 0)[:, None] * matrix * std / scale[:, None]
    return torch.cat((rows @ scaled, excess.clamp_min(0))), torch.cat((rows, of_excess))
