"""Sources of first poses for single pictures."""

from functools import lru_cache

from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.geometry import Camera
from torchhand.hand import HandKinematics, HandPose
from torchhand.track.single import PoseSource, SilhouetteTable

_OF_TABLE = 12  # hypotheses of each silhouette


def pose_sources(kinematics: HandKinematics) -> tuple[PoseSource, ...]:
    """All that there are; what they need is made when they are asked first."""

    @lru_cache(maxsize=1)
    def table() -> SilhouetteTable:
        return SilhouetteTable.of_prior(kinematics, kinematics.default_shape)

    def by_table(
        mask: Bool[Tensor, "height width"], image: Tensor | None, camera: Camera, shape: Float[Tensor, "shape"]
    ) -> HandPose:
        return table().placed(mask, camera, _OF_TABLE)[0]

    return (by_table,)
