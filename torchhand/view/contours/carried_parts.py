"""How pulls at the parts of a hand add up at its joints."""

from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.hand import BONES, PARENTS, ROOT_DOFS, HandKinematics


class CarriedParts:
    """Which DOFs carry which parts of a hand, for sums over all that a joint carries.

    With the screws s of the DOFs, parts p that each DOF carries, and moments M_p = Σ w q qᵀ of the wrenches q at each
    part, the matrix of the normal equations is H_jk = s_jᵀ (Σ M_p over the parts that both carry) s_k. Two joints carry
    the same parts only where one is above the other, and then those of the lower one: the composite inertias of a tree
    of bodies (Walker and Orin 1982).
    """

    def __init__(self, kinematics: HandKinematics, bones: Sequence[int], like: Tensor) -> None:
        """bones: of the parts."""
        carried = _carried(kinematics)[list(bones)].T
        self.by_dof: Float[Tensor, "36 parts"] = carried.to(like)
        # What the first carries, the second carries, too.
        self._is_lower: Bool[Tensor, "36 36"] = (~carried[:, None] | carried).all(-1).to(like.device)
        self._is_upper = self._is_lower.T.to(like)

    def equations(
        self, moments: Float[Tensor, "n parts 6 7"], screws: Float[Tensor, "n 36 6"]
    ) -> tuple[Float[Tensor, "n 36 36"], Float[Tensor, "n 36"]]:
        """Matrix and gradient in the DOFs.

        moments: of every part Σ w q qᵀ and, last, Σ w r q over its wrenches q with weights w and residuals r.
        """
        borne = (self.by_dof @ moments.flatten(2)).unflatten(2, (6, 7))
        felt = (borne * screws[..., None]).sum(2)
        below = felt[..., :6] @ screws.mT
        return torch.where(self._is_lower, below, below.mT * self._is_upper), felt[..., 6]


def _carried(kinematics: HandKinematics) -> Bool[Tensor, "20 36"]:
    """Whether a DOF moves a bone."""
    above = torch.eye(len(BONES), dtype=torch.bool)
    for bone in range(1, len(BONES)):
        above[bone] |= above[PARENTS[bone]]
    root = torch.ones(len(BONES), len(ROOT_DOFS), dtype=torch.bool)
    return torch.cat((root, above[:, list(kinematics.skeleton.bone)]), 1)
