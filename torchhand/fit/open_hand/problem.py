"""The unknowns of an open hand in one picture, with what is known of them before the picture is looked at.

Pose: fingers straight, seen square on (Ouhaddi and Horain 1998, section 7.1), each with a spread. Shape: mean and
spread over people, hand length and breadth correlated, and the 21 anthropometric intervals. Hand length is held: one
picture cannot tell it from depth.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.devices import HOST, sent_to
from torchhand.geometry import Camera
from torchhand.hand import DOFS, Anthropometry, HandKinematics
from torchhand.view import HandProjector

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

_STEP = 1e-4  # of the numerical derivative, prior standard deviations


@dataclass(frozen=True, kw_only=True)
class OpenHandProblem:
    """Scaled unknowns (x - mean) / std of the free pose DOFs, then of the free shape parameters, before one camera."""

    kinematics: HandKinematics
    camera: Camera
    """The camera, whose coordinates are the world."""
    root_reference: Float[Tensor, "3 3"]
    """Orientation about which the root turns, cam_from_hand."""
    population: Anthropometry
    pose: Float[Tensor, "36"]
    """Mean of the pose, and the values of what is held."""
    shape: Float[Tensor, "shape"]
    """Mean of the shape."""
    free_pose: Tensor
    """Indices of the free DOFs."""
    free_shape: Tensor
    """Indices of the free shape parameters."""
    std: Float[Tensor, "n"]
    """Prior standard deviations of the unknowns, in their own units."""
    lower: Float[Tensor, "n"]
    """Joint limits and lower bounds of the shape, scaled."""
    upper: Float[Tensor, "n"]
    """Joint limits and upper bounds of the shape, scaled."""
    intervals: tuple[Float[Tensor, "rows shape"], Float[Tensor, "rows"], Float[Tensor, "rows"]]
    """Anthropometric intervals: a matrix of the shape, bounds from above, and standard deviations of both."""

    @classmethod
    def about(
        cls,
        kinematics: HandKinematics,
        camera: Camera,
        pose: Float[Tensor, "36"],
        root_reference: Float[Tensor, "3 3"],
    ) -> "OpenHandProblem":
        """The problem with a pose and the mean shape over people as means, on the device of the pose."""
        population, device = Anthropometry(kinematics.shape_space), pose.device
        space, skeleton = population.space, kinematics.on(HOST).skeleton
        pose = pose.to(HOST)
        pose_std = torch.tensor(
            [next((std for end, std in _POSE_STD.items() if dof.endswith(end)), 0.0) for dof in DOFS], dtype=pose.dtype
        )
        shape_std = space.std.clone()
        length, breadth = (space.names.index(name) for name in ("hand_length", "hand_breadth"))
        shape_std[length] = 0.0
        shape_std[breadth] *= math.sqrt(1 - population.settings.length_breadth_correlation**2)
        free_pose, free_shape = pose_std.nonzero()[:, 0], shape_std.nonzero()[:, 0]
        std = torch.cat((pose_std[free_pose], shape_std[free_shape]))
        unbounded = torch.full((6,), torch.inf, dtype=pose.dtype)
        low = torch.cat((torch.cat((-unbounded, skeleton.lower))[free_pose], space.lower[free_shape]))
        high = torch.cat((torch.cat((unbounded, skeleton.upper))[free_pose], space.upper[free_shape]))
        shape = space.default.clone()
        for finger, proximal in _PROXIMAL.items():
            shape[space.names.index(f"{finger}_proximal")] = proximal
        mean, count, spread = (
            torch.cat((pose[free_pose], shape[free_shape])),
            len(space.names),
            population.spread.clone(),
        )
        spread[-1] *= shape[length]
        scale = population.settings.softness * torch.cat((spread, spread))
        problem = cls(
            kinematics=kinematics,
            camera=camera,
            root_reference=root_reference,
            population=population,
            pose=pose,
            shape=shape,
            free_pose=free_pose,
            free_shape=free_shape,
            std=std,
            lower=(low - mean) / std,
            upper=(high - mean) / std,
            intervals=(population.matrix[2 * count :], population.bound[2 * count :], scale),
        )
        return sent_to(problem, device)

    @property
    def size(self) -> int:
        """Number of unknowns."""
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

    def projected(self, values: Float[Tensor, "*batch n"]) -> tuple[HandProjector, Float[Tensor, "*batch 36"]]:
        """Hands of these shapes before the camera, and their poses."""
        pose, shape = self.split(values)
        return HandProjector(self.kinematics, self.camera, shape), pose

    def prior(self, values: Float[Tensor, "*batch n"]) -> Float[Tensor, "*batch rows"]:
        """Residuals of what is known beforehand: the unknowns, and by how much they leave anthropometric intervals.

        In standard deviations.
        """
        matrix, bound, scale = self.intervals
        excess = (self.split(values)[1] @ matrix.T - bound) / scale
        return torch.cat((values, excess.clamp_min(0)), -1)


def linearized(
    terms: Sequence[Callable[[Float[Tensor, "hands n"]], Float[Tensor, "hands _"]]], values: Float[Tensor, "n"]
) -> tuple[Float[Tensor, "rows"], Float[Tensor, "rows n"]]:
    """Residuals of all terms at scaled unknowns, one after the other, and their Jacobian by forward differences."""
    hands = torch.cat((values[None], values + _STEP * torch.eye(len(values), dtype=values.dtype, device=values.device)))
    found = torch.cat([term(hands) for term in terms], -1)
    return found[0], (found[1:] - found[0]).T / _STEP
