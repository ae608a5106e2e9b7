"""A small network from 21 points to a pose, with the hand's kinematics as its last layer."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from torchhand.geometry import rotation_from_columns
from torchhand.hand import DOFS, JOINT_DOFS, ROOT_DOFS, HandKinematics, HandModel, named_pose_space
from torchhand.learn.observation import FEATURES, Observation

POSE_SPACE = "dof27"
_ROOT = len(ROOT_DOFS)
_ROTATION, _PLACE = 6, 3
_USUAL_RADIUS = 0.055  # metres: root mean square distance of the keypoints from their mean, across the line of sight
_DEPTH_RANGE = 1.5  # of the logarithm: hands edge-on and closed look up to four times smaller


@dataclass(frozen=True, kw_only=True)
class HandEstimate:
    """Right hands in the camera frame, in the form that `HandKinematics` and `Hand` take."""

    pose: Float[Tensor, "*batch 36"]
    """Metres and radians; the rotation vector of the root is zero."""
    root_reference: Float[Tensor, "*batch 3 3"]
    """Rotation cam_from_hand."""
    shape: Float[Tensor, "*batch shape"]
    keypoints: Float[Tensor, "*batch 21 3"]
    """Keypoints in metres, camera frame."""


class PoseNetwork(nn.Module):
    """Residual multilayer perceptron; joint angles and shape parameters never leave their bounds.

    The angles of the 27-DOF space and the shape are bounded by sigmoids that start at the middle of what is usual; the
    root's rotation is two columns made orthogonal (Zhou et al. 2019, On the Continuity of Rotation Representations in
    Neural Networks); its place is an offset in the picture and a factor on the distance at which a usual hand has the
    size that is seen.
    """

    def __init__(
        self,
        model: HandModel,
        usual_joints: Float[Tensor, "30"],
        *,
        width: int = 256,
        blocks: int = 3,
    ) -> None:
        """usual_joints: joint angles from which training starts, radians."""
        super().__init__()
        space = named_pose_space(POSE_SPACE, dtype=torch.float32)
        free = [name for name in space.free_names if name not in ROOT_DOFS]
        index = torch.tensor([JOINT_DOFS.index(name) for name in free])
        skeleton, shapes = model.skeleton, model.shape_space
        self.kinematics: HandKinematics = model.kinematics(dtype=torch.float32)
        self.joint_basis: Tensor
        self.start: Tensor
        self.lower: Tensor
        self.upper: Tensor
        self.register_buffer("joint_basis", space.basis[_ROOT:, _ROOT:].clone(), persistent=False)
        lower = torch.cat((skeleton.lower[index], shapes.lower)).float()
        upper = torch.cat((skeleton.upper[index], shapes.upper)).float()
        usual = torch.cat((usual_joints.to(shapes.default)[index], shapes.default)).float()
        fraction = ((usual - lower) / (upper - lower)).clamp(0.02, 0.98)
        self.register_buffer("lower", lower, persistent=False)
        self.register_buffer("upper", upper, persistent=False)
        self.register_buffer("start", fraction.logit())
        self.joints = len(free)
        self.enter = nn.Linear(FEATURES, width)
        self.blocks = nn.ModuleList(_Block(width) for _ in range(blocks))
        self.leave = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, _ROTATION + _PLACE + len(usual)))

    def forward(self, seen: Observation) -> HandEstimate:
        """One hand for each observation, in the frame of the camera that saw it."""
        hidden = self.enter(seen.features)
        for block in self.blocks:
            hidden = block(hidden)
        turn, place, bounded = self.leave(hidden).split((_ROTATION, _PLACE, len(self.lower)), -1)
        within = self.lower + (self.upper - self.lower) * torch.sigmoid(self.start + bounded)
        joints, shape = within[..., : self.joints], within[..., self.joints :]
        depth = _USUAL_RADIUS / seen.size * (_DEPTH_RANGE * torch.tanh(place[..., 2])).exp()
        plane = seen.centre + seen.size[..., None] * place[..., :2]
        root_view = depth[..., None] * torch.cat((plane, torch.ones_like(plane[..., :1])), -1)
        root = (seen.cam_from_view @ root_view[..., None]).squeeze(-1)
        pose = torch.cat((root, torch.zeros_like(root), joints @ self.joint_basis.T), -1)
        assert pose.shape[-1] == len(DOFS)
        reference = seen.cam_from_view @ rotation_from_columns(turn)
        keypoints = self.kinematics(pose, shape, root_reference=reference).keypoints
        return HandEstimate(pose=pose, root_reference=reference, shape=shape, keypoints=keypoints)

    def usual_keypoints(self) -> Float[Tensor, "21 3"]:
        """Keypoints of the hand from which training started, in its own frame, metres."""
        usual = self.lower + (self.upper - self.lower) * torch.sigmoid(self.start)
        joints, shape = usual[: self.joints], usual[self.joints :]
        return self.kinematics(torch.cat((usual.new_zeros(_ROOT), self.joint_basis @ joints)), shape).keypoints


class _Block(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.inside = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, width), nn.GELU(), nn.Linear(width, width))

    def forward(self, hidden: Tensor) -> Tensor:
        return hidden + self.inside(hidden)
