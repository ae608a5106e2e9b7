"""Sources of first poses for single pictures of which no detector tells anything."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.fit.detect import align_posture
from torchhand.geometry import Camera
from torchhand.hand import DOFS, HandKinematics, HandPose, posture
from torchhand.track.single import PoseSource, learned_poses

_POSTURES = ("open", "flat", "point", "fist")  # laid over a silhouette, palm and back
_OF_EACH = 3  # placements of a posture


def pose_sources(kinematics: HandKinematics) -> tuple[PoseSource, ...]:
    """All that there are, in the order in which they are asked."""
    by_network = learned_poses(kinematics)

    def by_named_postures(
        mask: Bool[Tensor, "height width"], image: Tensor | None, camera: Camera, shape: Float[Tensor, "shape"]
    ) -> HandPose:
        found = [
            placed
            for name in _POSTURES
            for placed in align_posture(
                mask, camera, kinematics, shape, posture(name, dtype=torch.float64).to(shape), keep=_OF_EACH
            )
        ]
        if not found:
            return HandPose.of(shape.new_zeros(0, len(DOFS)))
        return HandPose.stack([HandPose.of(one.pose, one.root_reference) for one in found])

    def learned(
        mask: Bool[Tensor, "height width"], image: Tensor | None, camera: Camera, shape: Float[Tensor, "shape"]
    ) -> HandPose:
        can_propose = camera.kind == "pinhole" and bool(mask.any())
        return (by_network if can_propose else by_named_postures)(mask, image, camera, shape)

    return (learned,)
