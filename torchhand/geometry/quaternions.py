"""Rotations as unit quaternions (x, y, z, w), the order of glTF and OpenXR."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.geometry.rotations import vector_from_rotation
from torchhand.precision import own_precision


@own_precision
def quaternion_of_rotation(rotation: Float[Tensor, "*batch 3 3"]) -> Float[Tensor, "*batch 4"]:
    """w is never negative."""
    half = 0.5 * vector_from_rotation(rotation)
    angle = half.norm(dim=-1, keepdim=True)
    return torch.cat((half * torch.sinc(angle / torch.pi), angle.cos()), -1)


@own_precision
def rotation_of_quaternion(quaternion: Float[Tensor, "*batch 4"]) -> Float[Tensor, "*batch 3 3"]:
    """Rotation of a quaternion of any length but zero."""
    x, y, z, w = (quaternion / quaternion.norm(dim=-1, keepdim=True)).unbind(-1)
    rows = (
        torch.stack((1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)), -1),
        torch.stack((2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)), -1),
        torch.stack((2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)), -1),
    )
    return torch.stack(rows, -2)


@own_precision
def continuous(quaternion: Float[Tensor, "frames *rest 4"]) -> Float[Tensor, "frames *rest 4"]:
    """The same rotations with signs that never jump from frame to frame, so that interpolation takes the short way."""
    if len(quaternion) < 2:
        return quaternion
    jumps = torch.where((quaternion[1:] * quaternion[:-1]).sum(-1, keepdim=True) < 0, -1.0, 1.0).to(quaternion)
    return torch.cat((quaternion[:1], quaternion[1:] * jumps.cumprod(0)))
