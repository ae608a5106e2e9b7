"""Meshes as a camera has them in its pictures: what silhouettes and depth are both made from."""

from dataclasses import dataclass

from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.view.soft.boundary import Boundary
from torchhand.view.soft.edges import ContourEdges


@dataclass(frozen=True, kw_only=True)
class PlacedMeshes:
    """Meshes of a flat batch, one in each picture."""

    points_px: Float[Tensor, "pictures vertices 2"]
    nearness: Float[Tensor, "pictures vertices"]
    """Number that is affine over a face's picture and grows towards the camera: 1/z (orthographic: -z)."""
    is_orthographic: bool
    is_seen: Bool[Tensor, "pictures faces"]
    """Faces turned to the camera."""
    contour: ContourEdges
    boundary: Boundary

    @property
    def flat_px(self) -> Float[Tensor, "points 2"]:
        """The vertices of all pictures, one picture after the other."""
        return self.points_px.reshape(-1, 2)

    def depth_of(self, nearness: Tensor) -> Tensor:
        """z in the camera frame, metres."""
        return -nearness if self.is_orthographic else nearness.reciprocal()
