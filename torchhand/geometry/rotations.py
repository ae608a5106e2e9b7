"""Rotation vectors and matrices: exponential, logarithm, left Jacobian; exact and smooth at zero."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.devices import kept
from torchhand.precision import own_precision

_SMALL_ANGLE_SQUARED = 1e-8  # below it the series is exact to float64 rounding in its first two terms


@own_precision
def skew(vector: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    """Matrix of the cross product: skew(a) @ b = a x b."""
    x, y, z = vector.unbind(-1)
    zero = torch.zeros_like(x)
    return torch.stack((zero, -z, y, z, zero, -x, -y, x, zero), -1).unflatten(-1, (3, 3))


def ordered_product(
    rows: Float[Tensor, "*batch n 3"], matrix: Float[Tensor, "*batch 3 c"]
) -> Float[Tensor, "*batch n c"]:
    """rows @ matrix, as single products and sums: the same bits for one as in a batch, and on every processor."""
    x, y, z = rows[..., None].unbind(-2)
    to_x, to_y, to_z = matrix[..., None, :, :].unbind(-2)
    return x * to_x + y * to_y + z * to_z


def exponential_coefficients(
    angle_squared: Float[Tensor, "*batch"],
) -> tuple[Float[Tensor, "*batch"], Float[Tensor, "*batch"], Float[Tensor, "*batch"]]:
    """sin(a)/a, (1 - cos a)/a², (a - sin a)/a³ of a = sqrt(angle_squared), with finite derivatives at zero.

    exp(v) = I + first [v] + second [v]²; its left Jacobian is I + second [v] + third [v]².
    """
    is_small, safe, angle = _safe_angle(angle_squared)
    sine = angle.sin()
    first = torch.where(is_small, 1 - angle_squared / 6 * (1 - angle_squared / 20), sine / angle)
    third = _third_coefficient(angle_squared, is_small, safe, angle, sine)
    return first, _second_coefficient(angle_squared, is_small, safe, angle), third


def _safe_angle(angle_squared: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Whether angles are small; their squares and they themselves, 1 where they are."""
    is_small = angle_squared < _SMALL_ANGLE_SQUARED
    safe = torch.where(is_small, torch.ones_like(angle_squared), angle_squared)
    return is_small, safe, safe.sqrt()


def _second_coefficient(angle_squared: Tensor, is_small: Tensor, safe: Tensor, angle: Tensor) -> Tensor:
    half_sine = (0.5 * angle).sin()  # 1 - cos a = 2 sin²(a/2) keeps its digits at small angles
    return torch.where(is_small, 0.5 - angle_squared / 24 * (1 - angle_squared / 30), 2 * half_sine**2 / safe)


def _third_coefficient(angle_squared: Tensor, is_small: Tensor, safe: Tensor, angle: Tensor, sine: Tensor) -> Tensor:
    series = 1 / 6 - angle_squared / 120 * (1 - angle_squared / 42)
    return torch.where(is_small, series, (angle - sine) / (safe * angle))


@own_precision
def rotation_from_vector(vector: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    """Rotation by |vector| radians about vector (Rodrigues); smooth everywhere, zero included."""
    if (
        not torch.compiler.is_compiling()
        and torch.is_inference_mode_enabled()
        and not torch._C._are_functorch_transforms_active()
    ):
        return _rotation_without_derivative(vector)
    squared = (vector * vector).sum(-1)
    is_small, safe, angle = _safe_angle(squared)
    first = torch.where(is_small, 1 - squared / 6 * (1 - squared / 20), angle.sin() / angle)
    second = _second_coefficient(squared, is_small, safe, angle)
    # I + first [v] + second [v]², of single products: the same bits for one as in a batch
    cosine = (1 - second * squared)[..., None, None] * torch.eye(3, dtype=vector.dtype, device=vector.device)
    products = (second[..., None] * vector)[..., None] * vector[..., None, :]
    return cosine + products + skew(first[..., None] * vector)


def _rotation_without_derivative(vector: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    """The same in a third of the operations, which has no derivative at zero."""
    turns = torch.linalg.vector_norm(vector, dim=-1, keepdim=True) / torch.pi
    second = 0.5 * torch.sinc(0.5 * turns).square()
    products = (second * vector)[..., None] * vector[..., None, :]
    terms = torch.cat((torch.sinc(turns) * vector, products.flatten(-2)), -1).reshape(-1, 12)
    identity, matrix = _kept_rodrigues(vector.dtype, vector.device)
    return torch.addmm(identity, terms, matrix).reshape(*vector.shape, 3)


def rodrigues_matrix(like: Tensor) -> Float[Tensor, "9 12"]:
    """From v and the products of its components, each with its factor, to the entries of [v] + [v]², which are linear
    in v and in v vᵀ - |v|² I; in the dtype and on the device of a tensor."""
    identity = torch.eye(3, dtype=like.dtype, device=like.device)
    of_vector = skew(identity).flatten(1).T
    of_products = torch.eye(9, dtype=like.dtype, device=like.device) - identity.reshape(9, 1) * identity.reshape(1, 9)
    return torch.cat((of_vector, of_products), 1)


@kept(16)
def _kept_rodrigues(dtype: torch.dtype, device: torch.device) -> tuple[Float[Tensor, "9"], Float[Tensor, "12 9"]]:
    like = torch.zeros((), dtype=dtype, device=device)
    return torch.eye(3, dtype=dtype, device=device).flatten(), rodrigues_matrix(like).T.contiguous()


@kept(16)
def _quaternion_products(dtype: torch.dtype, device: torch.device) -> Tensor:
    """Affine map (1 + 9, 16) from the entries of a rotation to four times the products of its quaternion's parts."""
    return _quaternion_table().to(dtype=dtype, device=device)


def _quaternion_table() -> Tensor:
    table = torch.zeros(10, 4, 4, dtype=torch.float64)
    table[0] = torch.eye(4)
    for i in range(3):
        table[1 + 4 * i].diagonal().add_(torch.tensor((1.0, -1.0, -1.0, -1.0)))
        table[1 + 4 * i, 1 + i, 1 + i] += 2.0
        j, k = (i + 1) % 3, (i + 2) % 3
        for row, column, sign in ((k, j, 1.0), (j, k, -1.0)):  # w times x, y, z
            table[1 + 3 * row + column, 0, 1 + i] = table[1 + 3 * row + column, 1 + i, 0] = sign
        for row, column in ((i, j), (j, i)):
            table[1 + 3 * row + column, 1 + i, 1 + j] = table[1 + 3 * row + column, 1 + j, 1 + i] = 1.0
    return table.flatten(1)


@own_precision
def vector_from_rotation(rotation: Float[Tensor, "*batch 3 3"]) -> Float[Tensor, "*batch 3"]:
    """Rotation vector of a rotation matrix, length in [0, π].

    Goes through the unit quaternion of largest component, so it is accurate near π as well; at exactly π the sign of
    the vector is arbitrary, and the derivative does not exist.
    """
    # Four times the outer product of the quaternion (w, x, y, z) with itself; its rows are multiples of the quaternion.
    rows = _quaternion_products(rotation.dtype, rotation.device)
    rows = torch.addmm(rows[0], rotation.reshape(-1, 9), rows[1:]).reshape(*rotation.shape[:-2], 4, 4)
    best = torch.diagonal(rows, dim1=-2, dim2=-1).argmax(-1)
    row = torch.take_along_dim(rows, best[..., None, None].expand(*best.shape, 1, 4), -2).squeeze(-2)
    quaternion = row / row.norm(dim=-1, keepdim=True)
    quaternion = torch.where(quaternion[..., :1] < 0, -quaternion, quaternion)
    scalar, vector = quaternion[..., 0], quaternion[..., 1:]
    sine_squared = (vector * vector).sum(-1)
    is_small = sine_squared < _SMALL_ANGLE_SQUARED
    sine = torch.where(is_small, torch.ones_like(sine_squared), sine_squared).sqrt()
    factor = torch.where(is_small, 2 + sine_squared / 3, 2 * torch.atan2(sine, scalar) / sine)
    return factor[..., None] * vector


@own_precision
def cosine_between(
    first: Float[Tensor, "*#batch 3 3"], second: Float[Tensor, "*#batch 3 3"]
) -> Float[Tensor, "*batch"]:
    """Cosine of the angle of the rotation that leads from one to the other; rounding may take it past 1."""
    return 0.5 * ((first * second).sum((-2, -1)) - 1)


@own_precision
def left_jacobian(vector: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    """J with exp(v + dv) = exp(J dv) exp(v) to first order."""
    squared = (vector * vector).sum(-1)
    is_small, safe, angle = _safe_angle(squared)
    second = _second_coefficient(squared, is_small, safe, angle)
    third = _third_coefficient(squared, is_small, safe, angle, angle.sin())
    cross = skew(vector)
    identity = torch.eye(3, dtype=vector.dtype, device=vector.device)
    return identity + second[..., None, None] * cross + third[..., None, None] * (cross @ cross)


@own_precision
def rotation_from_columns(columns: Float[Tensor, "*batch 6"]) -> Float[Tensor, "*batch 3 3"]:
    """The rotation that Gram and Schmidt make of its first two columns; the third is their product."""
    first = torch.nn.functional.normalize(columns[..., :3], dim=-1)
    second = columns[..., 3:] - (first * columns[..., 3:]).sum(-1, keepdim=True) * first
    second = torch.nn.functional.normalize(second, dim=-1)
    return torch.stack((first, second, torch.linalg.cross(first, second)), -1)
