"""What is known of an open hand before its picture is looked at.

Pose: fingers straight, seen square on (Ouhaddi and Horain 1998, section 7.1), each with a spread. Shape: mean and
spread over people, hand length and breadth correlated, and the 21 anthropometric intervals. Hand length is held: one
picture cannot tell it from depth.
"""

from dataclasses import replace

from torchhand.devices import sent_to
from torchhand.fit import GaussianPrior, PopulationPrior, Problem, SharedUnknowns
from torchhand.hand import DOFS, Anthropometry, HandKinematics, HandPose, pose_space

# Prior standard deviations about the start: metres and radians, by ending of the DOF's name.
_POSE_STD = {
    "root_tx": 0.03,
    "root_ty": 0.03,
    "root_tz": 0.10,
    "root_rx": 0.10,
    "root_ry": 0.10,
    "root_rz": 0.30,
    "thumb_cmc_fe": 0.35,
    "thumb_cmc_aa": 0.35,
    "thumb_mcp_fe": 0.30,
    "thumb_ip_fe": 0.30,
    "mcp_aa": 0.20,
    "mcp_fe": 0.10,
    "pip_fe": 0.10,
    "dip_fe": 0.07,
}

# Published tables of the fingers' proximal phalanges differ by up to 8 % (Buchholz et al. 1992 among them). The prior's
# means lie between two of them.
_PROXIMAL = {"index": 0.255, "middle": 0.2715, "ring": 0.2515, "little": 0.205}


def open_hand_problem(kinematics: HandKinematics, population: Anthropometry, pose: HandPose) -> Problem:
    """The problem without its observations, on the device of the pose () about which the hand is believed to be."""
    std = {dof: next((std for end, std in _POSE_STD.items() if dof.endswith(end)), 0.0) for dof in DOFS}
    free = tuple(dof for dof in DOFS if std[dof] > 0)
    space = pose_space("open hand", free).to(device=pose.dofs.device).about(pose.dofs)
    names, mean = population.space.names, population.space.default.clone()
    for finger, proximal in _PROXIMAL.items():
        mean[names.index(f"{finger}_proximal")] = proximal
    mean = sent_to(mean, pose.dofs.device)
    shown = tuple(i for i, name in enumerate(names) if name != "hand_length" and float(population.space.std[i]) > 0)
    return Problem(
        space=space,
        skeleton=kinematics.skeleton,
        shape=mean,
        observations=(),
        priors=(GaussianPrior.of_std(pose, pose.dofs.new_tensor([std[dof] for dof in free]), space),),
        shared=replace(
            SharedUnknowns.of_shape(population, shown), prior=PopulationPrior(population=population, mean=mean)
        ),
    )
