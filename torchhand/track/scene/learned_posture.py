"""The posture and the direction that a trained network sees in one camera's picture of a hand near a known place."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.devices import kept
from torchhand.files import load_presence_network, load_proposal_network
from torchhand.fit import GaussianPrior, Observation
from torchhand.fit.keypoints import PostureKeypoints
from torchhand.geometry import Camera
from torchhand.hand import DOFS, FINGERS, JOINT_DOFS, HandKinematics, HandPose, PoseSpace, named_pose_space
from torchhand.propose import LearnedPosture, Silhouette, hand_presence, learned_posture
from torchhand.track.scene.keypoints import parts_of
from torchhand.track.scene.views import Scene

_BENDING = ("_mcp_fe", "_pip_fe", "_dip_fe", "_ip_fe")
_CREDIBLE = 2.2  # root mean square deviation of a finger's flexions, standard deviations: at most 1 % by chance (χ²)

_FLEXIONS = [
    [i for i, name in enumerate(JOINT_DOFS) if name.startswith(finger) and name.endswith(_BENDING)]
    for finger in FINGERS
]


def seen_posture(
    scene: Scene, camera: Camera, kinematics: HandKinematics, pose: HandPose, shape: Float[Tensor, "shape"]
) -> LearnedPosture | None:
    """What the network sees of the hand near a pose () in the only view of a scene; None without a silhouette."""
    seen, network = seen_silhouette(scene, camera), load_proposal_network(device=shape.device)
    return None if seen is None else learned_posture(network, seen, kinematics, pose, shape)


def seen_presence(
    scene: Scene, camera: Camera, kinematics: HandKinematics, pose: HandPose, shape: Float[Tensor, "shape"]
) -> float | None:
    """Logarithm of how much likelier a hand at a pose () in the only view of a scene is than something else there, as a
    network sees it; None without a silhouette."""
    seen, network = seen_silhouette(scene, camera), load_presence_network(device=shape.device)
    return None if seen is None else float(hand_presence(network, seen, kinematics, pose, shape))


def seen_silhouette(scene: Scene, camera: Camera) -> Silhouette | None:
    """The silhouette of the only view of a scene; None where nothing is in it."""
    plane = scene.plane(0)
    if plane is None or not bool((mask := plane > 0.5).any()):
        return None
    return Silhouette(mask=mask, camera=camera, image=scene.views[0].image)


def learned_observations(
    seen: LearnedPosture, pose: HandPose, *, without: Bool[Tensor, "5"] | None = None
) -> tuple[PostureKeypoints, Observation]:
    """The joint angles and the direction that were seen, as observations of the hand near a pose (). without: fingers
    whose angles are not believed."""
    none, rotation = pose.dofs.new_zeros(len(DOFS) - len(JOINT_DOFS)), pose.rotation
    direction, precision = seen.direction_near(rotation)
    space, turns = _space(none.device)
    information = none.new_zeros(space.size, space.size)
    information[turns, turns] = precision.to(none)
    believed = seen.variance.reciprocal()
    if without is not None:
        believed = believed.masked_fill(without.repeat_interleave(len(JOINT_DOFS) // len(FINGERS)), 0.0)
    return (
        PostureKeypoints(
            pose=HandPose(dofs=torch.cat((none, seen.joints))[None], reference=rotation[None]),
            precision=believed[None],
        ),
        GaussianPrior(
            pose=HandPose(dofs=pose.dofs.new_zeros(len(DOFS)), reference=direction),
            information=information,
            space=space,
        ),
    )


def credible_posture(
    seen: LearnedPosture, pose: HandPose, free_names: tuple[str, ...]
) -> tuple[HandPose, Bool[Tensor, "free"]]:
    """The hand at a pose () with the angles that were seen, and which free parameters are of fingers whose angles there
    differ from these by more than an error of the network explains."""
    joints = pose.dofs[-len(JOINT_DOFS) :]
    deviation = (joints - seen.joints).square() / seen.variance
    is_far = torch.stack([deviation[rows].mean() for rows in _FLEXIONS]).sqrt() > _CREDIBLE
    is_put = torch.cat((torch.zeros_like(is_far[:1]), is_far))[parts_of(free_names, is_far.device)]
    return HandPose(dofs=torch.cat((pose.dofs[: -len(JOINT_DOFS)], seen.joints)), reference=pose.reference), is_put


@kept(4)
def _space(device: torch.device) -> tuple[PoseSpace, list[int]]:
    """The space in which a direction is told, and the places of the root's rotation in it."""
    space = named_pose_space("dof27").to(device=device)
    return space, [space.free_names.index(name) for name in ("root_rx", "root_ry", "root_rz")]
