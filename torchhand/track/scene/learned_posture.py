"""The posture and the direction that a trained network sees in one camera's picture of a hand near a known place."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.files import load_proposal_network
from torchhand.fit import GaussianPrior, Observation
from torchhand.fit.keypoints import PostureKeypoints
from torchhand.geometry import Camera
from torchhand.hand import DOFS, JOINT_DOFS, HandKinematics, HandPose, named_pose_space
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


def learned_observations(seen: LearnedPosture, pose: HandPose) -> tuple[Observation, Observation]:
    """The joint angles and the direction that were seen, as observations of the hand near a pose ()."""
    none, rotation = pose.dofs.new_zeros(len(DOFS) - len(JOINT_DOFS)), pose.rotation
    direction, precision = seen.direction_near(rotation)
    space = named_pose_space("dof27")
    information = torch.zeros(space.size, space.size, dtype=none.dtype)
    turns = [space.free_names.index(name) for name in ("root_rx", "root_ry", "root_rz")]
    information[turns, turns] = precision.to(none)
    return (
        PostureKeypoints(
            pose=HandPose(dofs=torch.cat((none, seen.joints))[None], reference=rotation[None]),
            precision=seen.variance.reciprocal()[None],
        ),
        GaussianPrior(
            pose=HandPose(dofs=pose.dofs.new_zeros(len(DOFS)), reference=direction),
            information=information,
            space=space,
        ),
    )
