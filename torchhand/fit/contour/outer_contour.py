"""Model outline against the picture's outer contour, through its distance map (paper 000, equations 9 to 11)."""

from jaxtyping import Float, Int
from torch import Tensor

from torchhand.image import DistanceField
from torchhand.view import ContourMotion


def outer_contour_residual(
    motion: ContourMotion, field: DistanceField, channel: Int[Tensor, "hands points"] | None = None
) -> tuple[Float[Tensor, "hands points"], Float[Tensor, "hands points free"]]:
    """Distance in px of every model point from the picture's contour, and its derivative in the pose space.

    The derivative is the map's gradient times the motion of the point (equation 11). channel: of an oriented map, as
    `channel_of` the points' normals. Signed maps make it positive outside the silhouette. Points that are hidden are
    the caller's to leave out.
    """
    distance, gradient = field.sample(motion.points_px, channel)
    return distance, motion.along(gradient)
