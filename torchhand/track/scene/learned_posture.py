"""The posture that a trained network sees in one camera's picture, as an observation of the hand that is followed."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.files import load_proposal_network
from torchhand.fit.keypoints import PostureKeypoints
from torchhand.geometry import Camera
from torchhand.hand import DOFS, JOINT_DOFS, HandKinematics, HandPose
from torchhand.propose import Silhouette, learned_posture
from torchhand.track.scene.views import Scene


def observed_posture(
    scene: Scene, camera: Camera, kinematics: HandKinematics, pose: HandPose, shape: Float[Tensor, "shape"]
) -> PostureKeypoints | None:
    """Joint angles of the hand near a pose () in the only view of a scene; None without a silhouette."""
    plane, image = scene.plane(0), scene.views[0].image
    if plane is None or not bool((mask := plane > 0.5).any()):
        return None
    seen = Silhouette(mask=mask, camera=camera, image=image)
    found = learned_posture(load_proposal_network(), seen, kinematics, pose, shape)
    dofs = torch.cat((pose.dofs.new_zeros(len(DOFS) - len(JOINT_DOFS)), found.joints))
    return PostureKeypoints(
        pose=HandPose(dofs=dofs[None], reference=pose.rotation[None]), precision=found.variance.reciprocal()[None]
    )
