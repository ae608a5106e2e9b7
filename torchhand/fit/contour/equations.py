"""Normal equations of whatever is measured along the normals of contours, in the DOFs and in the shape."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.devices import are_equal
from torchhand.fit import Equations, PosedHands
from torchhand.view import ContourMotion, Contours, VisibleContour
from torchhand.view.contours import PointToLineTerms


@dataclass(frozen=True, kw_only=True)
class MovingContour:
    """Points of contours that were associated with data, and how they move with the hands."""

    contours: Contours
    visible: VisibleContour
    hands: PosedHands
    motion: ContourMotion
    """Motion with the DOFs, at these hands."""

    @classmethod
    def of(
        cls, contours: Contours, visible: VisibleContour, hands: PosedHands, associated: PosedHands | None
    ) -> "MovingContour":
        """associated: the hands at which the points were visible, whose motion may be known."""
        motion = visible.motion if hands is associated else None
        if motion is None:
            motion = contours_of(contours, hands.shape, hands).motion(hands.pose, visible)
        return cls(contours=contours, visible=visible, hands=hands, motion=motion)

    def equations(self, terms: PointToLineTerms, cost: Float[Tensor, "k"]) -> Equations:
        """Normal equations in the DOFs, and in the shape where it is unknown."""
        matrix, gradient = self.motion.equations(terms)
        found = Equations(cost=cost, gradient=gradient, matrix=matrix)
        if self.hands.unknowns is None:
            return found
        rows = self.motion.slopes(terms.direction).flatten(1, 2)
        shared = (terms.direction[..., None] * self._shape_slopes()[:, None]).sum(2).flatten(1, 2)
        weighted = terms.curvature.flatten(1)[..., None] * shared
        return replace(
            found,
            mixed=rows.mT @ weighted,
            shared_gradient=(terms.gradient.flatten(1)[:, None] @ shared).squeeze(1),
            shared_matrix=shared.mT @ weighted,
        )

    def _shape_slopes(self) -> Float[Tensor, "k 2 points c"]:
        """Derivative of the points in the shared unknowns, px; none but the shape moves them."""
        hands = self.hands
        assert hands.unknowns is not None
        own = contours_of(self.contours, hands.shape, hands)
        slopes = own.shape_slopes(hands.pose, self.visible, hands.unknowns.columns)
        return torch.nn.functional.pad(slopes, (0, len(hands.unknowns.extra)))


def contours_of(contours: Contours, shape: Float[Tensor, "shape"], hands: PosedHands) -> Contours:
    """Contours of the hands' shape; remade once where they must be."""

    def own() -> Contours:
        return contours if are_equal(shape, contours.shape) else contours.with_shape(shape)

    return contours if shape is contours.shape else hands.once_for_shape(id(contours), own)
