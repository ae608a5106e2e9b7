"""The posture and the direction that a trained network sees in one camera's picture of a hand near a known place."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.files import load_proposal_network
from torchhand.fit.keypoints import PostureKeypoints
from torchhand.geometry import Camera
from torchhand.hand import DOFS, JOINT_DOFS, HandKinematics, HandPose
from torchhand.propose import LearnedPosture, Silhouette, learned_posture
from torchhand.track.scene.views import Scene


def seen_posture(
    scene: Scene, camera: Camera, kinematics: HandKinematics, pose: HandPose, shape: Float[Tensor, "shape"]
) -> LearnedPosture | None:
    """What the network sees of the hand near a pose () in the only view of a scene; None without a silhouette."""
    plane, image = scene.plane(0), scene.views[0].image
    if plane is None or not bool((mask := plane > 0.5).any()):
        return None
    seen = Silhouette(mask=mask, camera=camera, image=image)
    return learned_posture(load_proposal_network(), seen, kinematics, pose, shape)


def posture_observation(seen: LearnedPosture, pose: HandPose) -> PostureKeypoints:
    """The joint angles that were seen, as an observation of the hand near a pose ()."""
    dofs = torch.cat((pose.dofs.new_zeros(len(DOFS) - len(JOINT_DOFS)), seen.joints))
    return PostureKeypoints(
        pose=HandPose(dofs=dofs[None], reference=pose.rotation[None]), precision=seen.variance.reciprocal()[None]
    )
