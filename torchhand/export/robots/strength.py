"""How strong and how heavy an adult's hand is: torques that its joints bear, and its mass.

Fingertip forces are those of a tip pinch, 65 N between the means of men and women (Mathiowetz et al. 1985), which thumb
and index finger exert against each other; the other fingers follow by their shares of a grip (Li 2002: 32.2, 32.6, 23.5
and 11.7 %). Sideways a finger exerts a quarter of the 42.4 N with which four of them are squeezed together (Pataky et
al. 2008). A joint bears the force at its fingertip times the lever.
"""

import torch
from jaxtyping import Float64
from torch import Tensor

from torchhand.export.clip import MotionClip
from torchhand.hand import DOFS, FINGERS, JOINT_DOFS, TIPS, keypoint_jacobian

HAND_MASS = 0.40
"""kg, of a hand of the default proportions: 0.6 % of the body's mass (Winter 2009), adults of 58 to 75 kg."""
VELOCITY = 20.0
"""Largest speed of every joint, rad/s: that of the fastest finger movements."""
_PINCH_N, _SQUEEZE_N = 65.0, 42.4
_GRIP_SHARES = {"index": 32.2, "middle": 32.6, "ring": 23.5, "little": 11.7}
_LEAST_LEVER = 0.005  # metres: no joint is without friction


def joint_torques(clip: MotionClip) -> Float64[Tensor, "30"]:
    """What each joint angle of a clip's hand bears at its fingertip's largest force, N m, in the order of JOINT_DOFS.

    The lever is the fingertip's motion per turn, the larger of that with straight fingers and that in the middle of the
    joints' ranges.
    """
    skeleton = clip.skeleton
    poses = torch.zeros(2, len(DOFS), dtype=torch.float64)
    poses[1, -len(JOINT_DOFS) :] = 0.5 * (skeleton.lower + skeleton.upper)
    frames = clip.kinematics(poses, clip.shape)
    motion = keypoint_jacobian(clip.kinematics, poses, frames)[:, list(TIPS)].norm(dim=-2).amax(0)  # (fingers, 36)
    torques = []
    for dof in JOINT_DOFS:
        finger = dof.split("_")[0]
        lever = max(_LEAST_LEVER, float(motion[FINGERS.index(finger), DOFS.index(dof)]))
        torques.append(lever * _force(finger, dof))
    return torch.tensor(torques, dtype=torch.float64)


def _force(finger: str, dof: str) -> float:
    """Newtons at the fingertip. The thumb presses by both angles of its base."""
    if dof.endswith("_fe") or dof == "thumb_cmc_aa":
        return _PINCH_N * _GRIP_SHARES.get(finger, _GRIP_SHARES["index"]) / _GRIP_SHARES["index"]
    return _SQUEEZE_N / len(_GRIP_SHARES)
