"""Small vectors and matrices with the batch as the last, contiguous axis: many times faster than batches of 3 x 3
products.

A matrix is (k, 3, 3, n), a vector (k, 3, n); n may be 1 where it is shared by the whole batch.
"""

import torch
from jaxtyping import Float
from torch import Tensor


def common_shape(*tensors: Tensor) -> torch.Size:
    """What the shapes of tensors broadcast to. `torch.broadcast_shapes` tells the same, but loads SymPy: 0.4 s."""
    return torch.broadcast_tensors(*tensors)[0].shape


def batch_last(tensor: Tensor, own: int, batch: tuple[int, ...]) -> Tensor:
    """(*batch, own dims) as (own dims, N), or as (own dims, 1) where the tensor has no batch."""
    if tensor.ndim == own:
        return tensor[..., None]
    dims = tensor.shape[tensor.ndim - own :]
    return tensor.expand(*batch, *dims).reshape(-1, *dims).movedim(0, -1)


def batch_first(tensor: Tensor, batch: tuple[int, ...]) -> Tensor:
    """(own dims, N) as (*batch, own dims), without copying; an n of 1 is repeated over the batch."""
    first = tensor.movedim(-1, 0)
    if first.shape[0] == 1:
        return first[0].expand(*batch, *first.shape[1:])
    return first.reshape(*batch, *first.shape[1:])


def turn(matrix: Float[Tensor, "#k 3 3 #n"], vector: Float[Tensor, "#k 3 #n"]) -> Float[Tensor, "k 3 n"]:
    """Matrix times vector."""
    columns, parts = matrix.unbind(2), vector.chunk(3, 1)
    product = torch.addcmul(columns[0] * parts[0], columns[1], parts[1])
    return torch.addcmul(product, columns[2], parts[2])


def turn_back(matrix: Float[Tensor, "#k 3 3 #n"], vector: Float[Tensor, "#k 3 #n"]) -> Float[Tensor, "k 3 n"]:
    """Transposed matrix times vector."""
    return turn(matrix.transpose(1, 2), vector)


def compose(left: Float[Tensor, "#k 3 3 #n"], right: Float[Tensor, "#k 3 c #n"]) -> Float[Tensor, "k 3 c n"]:
    """Matrix times matrix."""
    columns, rows = left.chunk(3, 2), right.chunk(3, 1)
    product = torch.addcmul(columns[0] * rows[0], columns[1], rows[1])
    return torch.addcmul(product, columns[2], rows[2])


def cross(left: Float[Tensor, "#k 3 *#n"], right: Float[Tensor, "#k 3 *#n"]) -> Float[Tensor, "k 3 *n"]:
    """Cross product; for any number of batch dimensions."""
    (ax, ay, az), (bx, by, bz) = left.unbind(1), right.unbind(1)
    return torch.stack((ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx), 1)
