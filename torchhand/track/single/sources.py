"""First poses of the hand in a single picture, as the trained network proposes them."""

from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.files import load_proposal_network
from torchhand.geometry import Camera
from torchhand.hand import DOFS, HandKinematics, HandPose
from torchhand.propose import Silhouette, propose_hands
from torchhand.track.single.fitter import PoseSource

_HYPOTHESES = 8  # of each silhouette


def learned_poses(kinematics: HandKinematics) -> PoseSource:
    """A source for pinhole cameras; it has no pose for an empty silhouette."""

    def learned(
        mask: Bool[Tensor, "height width"], image: Tensor | None, camera: Camera, shape: Float[Tensor, "shape"]
    ) -> HandPose:
        if not bool(mask.any()):
            return HandPose.of(shape.new_zeros(0, len(DOFS)))
        network, seen = load_proposal_network(device=shape.device), Silhouette(mask=mask, camera=camera, image=image)
        return propose_hands(network, (seen,), kinematics, shape, count=_HYPOTHESES).pose[0]

    return learned
