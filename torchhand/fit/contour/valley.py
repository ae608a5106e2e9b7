"""Inner outlines of the model against the dark lines of the picture (paper 000, sections 7.3 and 7.4)."""

from jaxtyping import Float
from torch import Tensor

from torchhand.image import DistanceField
from torchhand.view import ContourMotion


def valley_residual(
    motion: ContourMotion, valleys: DistanceField
) -> tuple[Float[Tensor, "hands points"], Float[Tensor, "hands points free"]]:
    """Distance in px of every model point from the nearest valley, and its derivative in the pose space.

    For points where one part of the hand is seen before another. By no means every such line is dark, so the loss must
    let far points go.
    """
    distance, gradient = valleys.sample(motion.points_px)
    return distance, motion.along(gradient)
