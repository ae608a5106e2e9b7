"""Normal equations of many blocks and some unknowns that all of them share: an arrow.

The blocks are eliminated (Schur complement), so that the cost of a step grows with their number and not with its cube
(Triggs et al. 2000, section 6).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.numerics.least_squares.records import NormalEquations

_MIN_DIAGONAL = 1e-12  # of the largest entry of the diagonal: an unknown without any influence stays solvable


@dataclass(frozen=True, kw_only=True)
class ArrowEquations:
    """A cost and its quadratic model in the unknowns of f blocks and c shared ones."""

    blocks: Float[Tensor, "f n n"]
    """Second derivative in the unknowns of each block."""
    mixed: Float[Tensor, "f n c"]
    shared: Float[Tensor, "c c"]
    block_gradient: Float[Tensor, "f n"]
    shared_gradient: Float[Tensor, "c"]
    cost: Float[Tensor, ""]

    @classmethod
    def cat(cls, parts: Sequence["ArrowEquations"]) -> "ArrowEquations":
        """The blocks of all parts, their costs added up."""
        joined = {
            name: torch.cat([getattr(one, name) for one in parts]) for name in ("blocks", "mixed", "block_gradient")
        }
        summed = {
            name: torch.stack([getattr(one, name) for one in parts]).sum(0)
            for name in ("shared", "shared_gradient", "cost")
        }
        return cls(**joined, **summed)

    def eliminated(self, fixed: Bool[Tensor, "f n"] | None = None) -> "Eliminated":
        """What is left of the shared unknowns once every block has followed them to its own minimum.

        fixed: unknowns of blocks that do not follow, such as those on a bound that the cost drives against it. A block
        whose matrix is not positive semi-definite does not follow at all.
        """
        is_open = torch.ones_like(self.block_gradient) if fixed is None else (~fixed).to(self.blocks)
        blocks = self.blocks * is_open[:, :, None] * is_open[:, None, :]
        diagonal = blocks.diagonal(dim1=-2, dim2=-1)
        diagonal += (1 - is_open) + _MIN_DIAGONAL * diagonal.amax(-1, keepdim=True)
        mixed = self.mixed * is_open[..., None]
        factor, info = torch.linalg.cholesky_ex(blocks)
        right = torch.cat((mixed, (self.block_gradient * is_open)[..., None]), -1)
        solved = torch.where((info == 0)[:, None, None], torch.cholesky_solve(right, factor), 0.0)
        correction = mixed.flatten(0, 1).mT @ solved.flatten(0, 1)
        matrix = self.shared - correction[:, :-1]
        return Eliminated(
            equations=NormalEquations(
                matrix=0.5 * (matrix + matrix.mT), gradient=self.shared_gradient - correction[:, -1], cost=self.cost
            ),
            follow=-solved[..., :-1],
            step=-solved[..., -1],
        )


@dataclass(frozen=True, kw_only=True)
class Eliminated:
    """Equations of the shared unknowns of an arrow."""

    equations: NormalEquations
    """No batch dimension. The cost is that of the blocks as they were, the gradient that after they have followed."""
    follow: Float[Tensor, "f n c"]
    """How the minima of the blocks change with the shared unknowns."""
    step: Float[Tensor, "f n"]
    """Steps of the blocks to their minima, the shared unknowns as they were."""
