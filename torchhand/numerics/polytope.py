"""The nearest point of a small convex polytope, exactly, for many points at once."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.precision import own_precision

_ON = 1e-9  # a vertex lies on a row, a candidate inside the polytope, to this much
_FARTHEST = 1e4  # points beyond are moved here first: infinity has no nearest point
_CHUNK = 2048


@dataclass(frozen=True, kw_only=True)
class Polytope:
    """{x : matrix · x <= bound}, bounded and not empty, with the planes of all its faces; float64 on any device.

    The nearest point y of x lies inside exactly one face, and x − y is perpendicular to that face; so y is the nearest
    point of that face's plane. Of the nearest points of all the planes, y is therefore the nearest one that lies in
    the polytope. Faces grow fast with the dimension: meant for up to four or five variables.
    """

    matrix: Float[Tensor, "rows n"]
    bound: Float[Tensor, "rows"]
    flatten: Float[Tensor, "faces n n"]
    """Nearest point of each face's plane: flatten · x + offset. The first face is the polytope itself: the identity."""
    offset: Float[Tensor, "faces n"]

    @own_precision
    def excess(self, point: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch rows"]:
        """matrix · x − bound: positive where a row is violated."""
        return point @ self.matrix.to(point).T - self.bound.to(point)

    @own_precision
    def nearest(self, point: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch n"]:
        """The nearest point of the polytope; points inside come back bit for bit.

        Worked in float64, given in the point's dtype, so idempotent in that dtype. The derivative is that of the
        projection onto the face's plane. A NaN makes the whole point NaN.
        """
        own = self.to(point.device)
        exact = point.double().clamp(-_FARTHEST, _FARTHEST)
        flat = exact.detach().reshape(-1, exact.shape[-1])
        slack = max(_ON, 4 * torch.finfo(point.dtype).eps)
        face = torch.cat([own._face(part, slack) for part in flat.split(_CHUNK)]).reshape(exact.shape[:-1])
        flatten, offset = own.flatten[face[..., None]].squeeze(-3), own.offset[face[..., None]].squeeze(-2)
        near = (flatten @ exact[..., None]).squeeze(-1) + offset
        near = torch.where((face == 0)[..., None], point.clamp(-_FARTHEST, _FARTHEST), near.to(point.dtype))
        return torch.where(point.isnan().any(-1, keepdim=True), torch.nan, near)

    def to(self, device: torch.device) -> "Polytope":
        """The same polytope on a device."""
        if self.matrix.device == device:
            return self
        return replace(self, **{name: getattr(self, name).to(device) for name in self.__dataclass_fields__})

    def _face(self, point: Tensor, slack: float) -> Tensor:
        """Index of the face whose plane holds the nearest point."""
        candidates = torch.einsum("fij,bj->bfi", self.flatten, point) + self.offset
        worst = (candidates @ self.matrix.T - self.bound).amax(-1)
        allowed = worst.new_full((len(self.flatten),), _ON)
        allowed[0] = slack
        distance = (candidates - point[:, None]).square().sum(-1)
        return torch.where(worst <= allowed, distance, torch.inf).argmin(-1)


def polytope(
    lower: Float[Tensor, "n"], upper: Float[Tensor, "n"], matrix: Float[Tensor, "more n"], bound: Float[Tensor, "more"]
) -> Polytope:
    """The polytope lower <= x <= upper, matrix · x <= bound, with its faces enumerated.

    Raises ValueError where no point satisfies all of them.
    """
    size = len(lower)
    identity = torch.eye(size, dtype=torch.float64)
    matrix = torch.cat((-identity, identity, matrix.double().cpu()))
    bound = torch.cat((-lower.double().cpu(), upper.double().cpu(), bound.double().cpu()))
    corners = _corners(matrix, bound)
    if not len(corners):
        raise ValueError("polytope: expected inequalities that some point satisfies, got contradictory ones")
    on_row = (corners @ matrix.T - bound).abs() <= _ON  # (corners, rows)
    flatten, offset, seen = [identity], [torch.zeros(size, dtype=torch.float64)], set()
    for count in range(1, size + 1):
        subsets = torch.combinations(torch.arange(len(matrix)), count)
        holding = on_row[:, subsets].all(-1).T  # (subsets, corners)
        for corners_of_face in holding[holding.any(-1)].numpy():
            members = corners_of_face.tobytes()
            if members in seen:
                continue
            seen.add(members)
            active = on_row[torch.from_numpy(corners_of_face)].all(0)
            inverse = torch.linalg.pinv(matrix[active])
            flatten.append(identity - inverse @ matrix[active])
            offset.append(inverse @ bound[active])
    return Polytope(matrix=matrix, bound=bound, flatten=torch.stack(flatten), offset=torch.stack(offset))


def _corners(matrix: Tensor, bound: Tensor) -> Tensor:
    """The points where as many rows as variables hold with equality, and the others hold."""
    subsets = torch.combinations(torch.arange(len(matrix)), matrix.shape[1])
    systems, sides = matrix[subsets], bound[subsets]
    is_regular = torch.linalg.det(systems).abs() > _ON
    points = torch.linalg.solve(systems[is_regular], sides[is_regular])
    points = points[((points @ matrix.T - bound) <= _ON).all(1)]
    is_new = [not bool(((points[:i] - point).abs() <= 10 * _ON).all(1).any()) for i, point in enumerate(points)]
    return points[torch.tensor(is_new, dtype=torch.bool)]
