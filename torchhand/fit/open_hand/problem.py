"""The unknowns of an open hand in one picture, with what is known of them before the picture is looked at.

Pose: fingers straight, seen square on (paper 000, section 7.1), each with a spread. Shape: mean and spread over people,
hand length and breadth correlated, and the 21 anthropometric intervals. Hand length is held: one picture cannot tell it
from depth.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.hand import DOFS, Anthropometry, HandKinematics

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

# Two published tables of the fingers' proximal phalanges differ by up to 8 % (FACTS 1.1 and 1.3); bone lengths (1.4)
# lie between. Their mean is the prior's.
_PROXIMAL = {"index": 0.255, "middle": 0.2715, "ring": 0.2515, "little": 0.205}


@dataclass(frozen=True, kw_only=True)
class OpenHandProblem:
    """Values x = (x - mean) / std of the free pose DOFs, then of the free shape parameters."""

    people: Anthropometry
    pose: Float[Tensor, "36"]
    """Mean of the pose, and the values of what is held."""
    shape: Float[Tensor, "shape"]
    free_pose: Tensor
    free_shape: Tensor
    std: Float[Tensor, "n"]
    """Prior standard deviations of the unknowns, in their own units."""
    lower: Float[Tensor, "n"]
    upper: Float[Tensor, "n"]
    """Joint limits and bounds of the shape, of the scaled unknowns."""

    @classmethod
    def about(cls, kinematics: HandKinematics, people: Anthropometry, pose: Float[Tensor, "36"]) -> "OpenHandProblem":
        """With a pose and people's mean shape as the means."""
        space, skeleton = people.space, kinematics.skeleton
        pose_std = torch.tensor(
            [next((std for end, std in _POSE_STD.items() if dof.endswith(end)), 0.0) for dof in DOFS], dtype=pose.dtype
        )
        shape_std = space.std.clone()
        length, breadth = (space.names.index(name) for name in ("hand_length", "hand_breadth"))
        shape_std[length] = 0.0
        shape_std[breadth] *= math.sqrt(1 - people.settings.length_breadth_correlation**2)
        free_pose, free_shape = pose_std.nonzero()[:, 0], shape_std.nonzero()[:, 0]
        std = torch.cat((pose_std[free_pose], shape_std[free_shape]))
        unbounded = torch.full((6,), torch.inf, dtype=pose.dtype)
        low = torch.cat((torch.cat((-unbounded, skeleton.lower))[free_pose], space.lower[free_shape]))
        high = torch.cat((torch.cat((unbounded, skeleton.upper))[free_pose], space.upper[free_shape]))
        shape = space.default.clone()
        for finger, proximal in _PROXIMAL.items():
            shape[space.names.index(f"{finger}_proximal")] = proximal
        mean = torch.cat((pose[free_pose], shape[free_shape]))
        return cls(
            people=people,
            pose=pose,
            shape=shape,
            free_pose=free_pose,
            free_shape=free_shape,
            std=std,
            lower=(low - mean) / std,
            upper=(high - mean) / std,
        )

    @property
    def size(self) -> int:
        return len(self.std)

    def split(
        self, values: Float[Tensor, "*batch n"]
    ) -> tuple[Float[Tensor, "*batch 36"], Float[Tensor, "*batch shape"]]:
        """Pose and shape of scaled unknowns."""
        change = values * self.std
        count, batch = len(self.free_pose), values.shape[:-1]
        pose = self.pose.expand(*batch, -1).index_add(-1, self.free_pose, change[..., :count])
        shape = self.shape.expand(*batch, -1).index_add(-1, self.free_shape, change[..., count:])
        return pose, shape

    def enlarged(self, values: Float[Tensor, "n"]) -> Float[Tensor, "n"]:
        """Change of the scaled unknowns with the logarithm of a factor on the hand's size and its distance.

        The picture stays as it is.
        """
        space = self.people.space
        pose, shape = self.split(values)
        names = [DOFS[i] for i in self.free_pose.tolist()]
        place = torch.tensor([name.startswith("root_t") for name in names])
        units = [(space.names[i], space.units[i]) for i in self.free_shape.tolist()]
        length = torch.tensor([unit == "/HL" or name == "hand_breadth" for name, unit in units])
        grown = torch.cat((place * pose[self.free_pose], length * shape[self.free_shape]))
        return grown / self.std

    def clamped(self, values: Float[Tensor, "n"]) -> Float[Tensor, "n"]:
        return values.clamp(self.lower, self.upper)

    def on_bound(self, values: Float[Tensor, "n"]) -> Bool[Tensor, "n"]:
        return (values <= self.lower) | (values >= self.upper)

    def prior(self, values: Float[Tensor, "n"]) -> tuple[Float[Tensor, "rows"], Float[Tensor, "rows n"]]:
        """Residuals of what is known beforehand, in standard deviations, and their Jacobian."""
        eye = torch.eye(self.size, dtype=values.dtype)
        people, count = self.people, len(self.people.space.names)
        matrix, bound = people.matrix[2 * count :], people.bound[2 * count :]
        spread = people.spread.clone()
        spread[-1] *= self.shape[people.space.names.index("hand_length")]
        scale = people.settings.softness * torch.cat((spread, spread))
        excess = (matrix @ self.split(values)[1] - bound) / scale
        slope = torch.zeros(len(matrix), self.size, dtype=values.dtype)
        slope[:, len(self.free_pose) :] = matrix[:, self.free_shape] * self.std[len(self.free_pose) :] / scale[:, None]
        is_over = excess > 0
        return torch.cat((values, excess.clamp_min(0))), torch.cat((eye, slope * is_over[:, None]))
