"""The skinned mesh of the hand as a frozen record. How it is posed is `skinning`'s, how it was made `modelling`'s."""

from dataclasses import dataclass, fields, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor


@dataclass(frozen=True, kw_only=True)
class HandMesh:
    """A closed surface that follows the bones and the shape vector; right hand, metres.

    Vertices at the bind pose are linear in the shape parameters in metres:
    vertices + shape_basis · (metres(shape) − metres(default)).
    """

    vertices: Float[Tensor, "vertices 3"]
    """Vertices in the hand frame, at `bind_pose` and the default shape."""
    faces: Int[Tensor, "faces 3"]
    """Counter-clockwise seen from outside."""
    shape_basis: Float[Tensor, "vertices 3 shape"]
    """Change of each vertex with each shape parameter in metres, at the bind pose."""
    skin_bones: Int[Tensor, "vertices 4"]
    """Bones that carry each vertex, index into BONES."""
    skin_weights: Float[Tensor, "vertices 4"]
    """Weights of each vertex's bones, which sum to one."""
    bind_pose: Float[Tensor, "36"]
    """Pose in which the vertices are given; root at the origin."""
    corrective_dofs: tuple[int, ...]
    """Joint angles that have a corrective, index into JOINT_DOFS."""
    corrective_basis: Float[Tensor, "vertices 3 corrective 2"]
    """Correctives of linear blend skinning at bent joints: offsets for sin and 1 − cos of each angle less its angle at
    the bind pose, in the frame of the bone that the angle moves, metres at the default hand breadth."""

    def to(self, *, dtype: torch.dtype | None = None, device: torch.device | str | None = None) -> "HandMesh":
        """The same mesh with its tensors moved; indices keep their dtype."""
        tensors = {f.name: getattr(self, f.name) for f in fields(self) if isinstance(getattr(self, f.name), Tensor)}
        moved = {
            name: value.to(dtype=dtype if value.is_floating_point() else None, device=device)
            for name, value in tensors.items()
        }
        return replace(self, **moved)
