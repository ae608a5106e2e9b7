"""A posed surface as plain triangles: what a camera needs of a skinned hand."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.hand.hand import Hand, HandState
from torchhand.precision import own_precision, record


@record("faces", "part_of_face")
@dataclass(frozen=True, kw_only=True)
class PosedMesh:
    """Closed surfaces of hands placed in one frame (world or camera), metres; the counterpart of `Primitives`."""

    vertices: Float[Tensor, "*batch vertices 3"]
    faces: Int[Tensor, "faces 3"]
    """Counter-clockwise seen from outside; every edge has two faces."""
    part_of_face: Int[Tensor, "faces"]
    """The bone with most weight at the corners of each face, index into BONES."""

    @own_precision
    def moved(self, rotation: Float[Tensor, "3 3"], translation: Float[Tensor, "3"]) -> "PosedMesh":
        """The same surfaces after X_new = rotation X + translation."""
        return replace(self, vertices=self.vertices @ rotation.T + translation)

    def select(self, index: int) -> "PosedMesh":
        """One hand of a flat batch."""
        return replace(self, vertices=self.vertices[index])

    @own_precision
    def vertex_normals(self) -> Float[Tensor, "*batch vertices 3"]:
        """Unit normals, outward: the mean of those of the faces around each vertex, weighted by area."""
        a, b, c = self.vertices[..., self.faces, :].unbind(-2)
        of_face = torch.linalg.cross(b - a, c - a)
        total = torch.zeros_like(self.vertices)
        for corner in self.faces.unbind(-1):
            total = total.index_add(-2, corner, of_face)
        return torch.nn.functional.normalize(total, dim=-1, eps=1e-30)


def posed_mesh(hand: Hand, state: HandState) -> PosedMesh:
    """The skin of what `hand` made of some poses."""
    weights = hand.skinning.weights.T
    first, second, third = (weights.index_select(0, corner) for corner in state.faces.unbind(-1))
    return PosedMesh(vertices=state.vertices, faces=state.faces, part_of_face=(first + second + third).argmax(-1))
