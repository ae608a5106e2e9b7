"""Sources of first poses for single pictures of which no detector tells anything."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.files import load_proposal_network
from torchhand.fit.detect import align_posture
from torchhand.geometry import Camera
from torchhand.hand import DOFS, HandKinematics, HandPose, posture
from torchhand.propose import Silhouette, propose_hands
from torchhand.track.single import PoseSource

_POSTURES = ("open", "flat", "point", "fist")  # laid over a silhouette, palm and back
_OF_EACH = 3  # placements of a posture
_OF_NETWORK = 8  # hypotheses of each silhouette


def pose_sources(kinematics: HandKinematics) -> tuple[PoseSource, ...]:
    """All that there are, in the order in which they are asked."""

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
        if camera.kind != "pinhole" or not bool(mask.any()):
            return by_named_postures(mask, image, camera, shape)
        seen = Silhouette(mask=mask, camera=camera, image=image)
        return propose_hands(
            load_proposal_network(device=shape.device), (seen,), kinematics, shape, count=_OF_NETWORK
        ).pose[0]

    return (learned,)
