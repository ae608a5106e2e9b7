"""A weak belief in a natural posture, for the joints that keypoints leave open."""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.devices import kept
from torchhand.fit import Equations, OwnFactor, PosedHands
from torchhand.hand import DOFS, FINGERS, JOINT_DOFS, KEYPOINTS, Skeleton

_DEG = math.pi / 180
_ROOT = len(DOFS) - len(JOINT_DOFS)
_TIE = 2 / 3  # flexion of the end joint over that of the middle joint (Ouhaddi and Horain 1998, eq. 1)
_TIE_STD_DEG = 15.0

# Mean and standard deviation in degrees of a hand at work, by the ending of the DOF's name: rough values of ours.
_NATURAL_DEG = {
    "thumb_cmc_fe": (0.0, 20.0),
    "thumb_cmc_aa": (25.0, 15.0),
    "thumb_cmc_tw": (0.0, 10.0),
    "thumb_mcp_fe": (15.0, 18.0),
    "thumb_mcp_aa": (0.0, 8.0),
    "thumb_ip_fe": (20.0, 25.0),
    "_cmc_fe": (2.0, 4.0),
    "_mcp_fe": (25.0, 35.0),
    "_mcp_aa": (2.0, 8.0),
    "_mcp_tw": (0.0, 4.0),
    "_pip_fe": (30.0, 35.0),
    "_dip_fe": (20.0, 25.0),
}


@dataclass(frozen=True, kw_only=True)
class NaturalPosture:
    """A Gaussian over the joint angles."""

    mean: Float[Tensor, "36"]
    """Mean angles, radians; zeros for the root, of which nothing is believed."""
    precision: Float[Tensor, "36 36"]
    """Inverse covariance; zero rows and columns for the root."""

    @cached_property
    def is_empty(self) -> bool:
        return not bool(self.precision.any())


@dataclass(frozen=True, kw_only=True)
class NaturalPrior(OwnFactor):
    """½ |posture - mean|² in the metric of the precision, counted DOF by DOF."""

    posture: NaturalPosture
    fraction: Float[Tensor, "#rows 36"]
    """0 to 1: how far the belief in the natural posture holds for each DOF: of each frame, or of all hypotheses."""

    def rows(self, rows: "Int[Tensor, 'n'] | slice") -> "NaturalPrior":
        """The rows of some of the frames; itself where there is one for all."""
        return self if len(self.fraction) == 1 else replace(self, fraction=self.fraction[rows])

    def equations(self, hands: PosedHands) -> Equations:
        """Normal equations in the joint angles."""
        root = self.fraction[:, _ROOT:].sqrt()
        precision = self.posture.precision[_ROOT:, _ROOT:].to(root)
        away = root * (hands.pose.dofs - self.posture.mean.to(root))[:, _ROOT:]
        pull, matrix = away @ precision, root[:, :, None] * precision * root[:, None]
        return Equations(
            cost=0.5 * (pull * away).sum(-1),
            gradient=root * pull,
            matrix=matrix.expand(len(hands), -1, -1),
            first_dof=_ROOT,
        )


@kept(4)
def natural_posture(*, dtype: torch.dtype = torch.float64, device: torch.device | str = "cpu") -> NaturalPosture:
    """Half-open, with independent angles but for the end joints of the fingers, which follow the middle ones."""
    return _natural_posture(dtype, device)


def _natural_posture(dtype: torch.dtype, device: torch.device | str) -> NaturalPosture:
    mean, precision = torch.zeros(len(DOFS), dtype=dtype), torch.zeros(len(DOFS), len(DOFS), dtype=dtype)
    for i, dof in enumerate(DOFS):
        if i >= _ROOT:
            ending = dof if dof in _NATURAL_DEG else dof[dof.index("_") :]
            mean[i], std = _NATURAL_DEG[ending][0] * _DEG, _NATURAL_DEG[ending][1] * _DEG
            precision[i, i] = std**-2
    for finger in FINGERS[1:]:
        row = torch.zeros(len(DOFS), dtype=dtype)
        row[DOFS.index(f"{finger}_dip_fe")], row[DOFS.index(f"{finger}_pip_fe")] = 1.0, -_TIE
        precision += torch.outer(row, row) / (_TIE_STD_DEG * _DEG) ** 2
    return NaturalPosture(mean=mean.to(device), precision=precision.to(device))


def limit_information(skeleton: Skeleton) -> Float[Tensor, "36"]:
    """What the limits alone tell about each angle: the inverse variance of a uniform distribution between them."""
    width = (skeleton.upper - skeleton.lower).clamp_min(1e-6)
    return torch.cat((torch.zeros_like(width[:_ROOT]), 12 / width.square()))


def points_of_dofs() -> tuple[tuple[int, ...], ...]:
    """Keypoints, for every DOF, without which it cannot be told: the ends of the bones on both sides of the joint.

    A twist is told only by the bone after the next. The root's six need none in particular.
    """
    table: list[tuple[int, ...]] = [()] * _ROOT
    for dof in JOINT_DOFS:
        finger, joint, kind = dof.split("_")
        chain = [KEYPOINTS.index("wrist"), *(i for i, name in enumerate(KEYPOINTS) if name.startswith(finger))]
        if finger != "thumb" and joint == "cmc":
            table.append((chain[1],))  # the CMC joint of a finger is no keypoint
            continue
        centre = chain.index(KEYPOINTS.index(f"{finger}_{joint}"))
        last = centre + (2 if kind == "tw" else 1)
        table.append(tuple(chain[centre - 1 : last + 1]))
    return tuple(table)


def missing_fraction(confidence: Float[Tensor, "*frames 21"]) -> Float[Tensor, "*frames 36"]:
    """1 for the DOFs of which a keypoint is missing (confidence 0), falling to 0 as the least confidence rises to 1."""
    joints = 1 - confidence[..., _needed_points().to(confidence.device)].amin(-1).clamp(0, 1)
    return torch.nn.functional.pad(joints, (_ROOT, 0))


@kept(1)
def _needed_points() -> Int[Tensor, "30 4"]:
    """`points_of_dofs` of the joint angles as one table; where there are fewer, the last one stands several times."""
    table = [(*points, *points[-1:] * (4 - len(points))) for points in points_of_dofs()[_ROOT:]]
    return torch.tensor(table)
