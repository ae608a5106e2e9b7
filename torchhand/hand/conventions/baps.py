"""MPEG-4 body animation parameters (BAPs) of one hand in both numberings, and our poses as their values.

The final numbering (ISO/IEC 14496-2) has 29 angles a hand, the draft that the papers of its time used 25: no bending
of the palm. Neither has the thumb's MCP abduction. The hand frame is the humanoid's root: one hand is all there is, so
tr_vertical, tr_lateral and tr_frontal (along y, x and z) are its wrist, and body turn, roll and tilt (about y, z and x,
applied in this order from the outside in) its rotation, in a world with y up and z forward.

Values are whole numbers: 1e-5 radians, and millimetres for the translations. Signs are ours: flexion positive,
abduction positive away from the middle finger (the standard's own were not to be had).
"""

from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.geometry import rotation_from_vector, vector_from_rotation
from torchhand.hand.kinematics import DOFS, JOINT_DOFS, Side
from torchhand.precision import own_precision

Numbering = Literal["final", "draft"]
NUMBERINGS: tuple[Numbering, ...] = ("final", "draft")

RADIANS_PER_UNIT, METRES_PER_UNIT = 1e-5, 1e-3
LARGEST_ID: dict[Numbering, int] = {"final": 186, "draft": 175}
"""Of the parameters without extensions."""

_BASES: dict[Numbering, dict[str, int]] = {
    "final": {"little": 123, "ring": 135, "middle": 147, "index": 159, "thumb": 171},
    "draft": {"little": 120, "ring": 130, "middle": 140, "index": 150, "thumb": 160},
}
_FINGER_DOFS = ("mcp_fe", "mcp_aa", "mcp_tw", "pip_fe", "dip_fe")
_THUMB_DOFS = ("cmc_fe", "cmc_aa", "cmc_tw", "mcp_fe", "ip_fe")
_ROOT_BASE: dict[Numbering, int] = {"final": 181, "draft": 170}
_ROOT: tuple[str, ...] = ("tr_vertical", "tr_lateral", "tr_frontal", "rt_body_turn", "rt_body_roll", "rt_body_tilt")


def bap_ids(numbering: Numbering, side: Side) -> dict[str, int]:
    """Number of the parameter of each of our joint angles that has one, and of tr_vertical … rt_body_tilt."""
    right = int(side == "right")
    ids = {}
    for finger, base in _BASES[numbering].items():
        dofs = _THUMB_DOFS if finger == "thumb" else _FINGER_DOFS
        if numbering == "final" and finger != "thumb":
            dofs = ("cmc_fe", *dofs)
        ids |= {f"{finger}_{dof}": base + 2 * i + right for i, dof in enumerate(dofs)}
    return ids | {name: _ROOT_BASE[numbering] + i for i, name in enumerate(_ROOT)}


@dataclass(frozen=True, kw_only=True)
class BapValues:
    """Values of the parameters in `bap_ids`, and what they leave out."""

    names: tuple[str, ...]
    """Names of the columns: joint angles, then tr_vertical … rt_body_tilt."""
    values: Int[Tensor, "*batch parameters"]
    residual: Float[Tensor, "*batch 30"]
    """Error of each joint angle, radians: all of those without a parameter, the rounding of the others."""


@own_precision
def baps_of_pose(pose: Float[Tensor, "*batch 36"], numbering: Numbering, side: Side) -> BapValues:
    """Values of our poses, given in a world with y up."""
    names = tuple(bap_ids(numbering, side))
    angles = {dof: pose[..., DOFS.index(dof)].double() for dof in names if dof in JOINT_DOFS}
    turn, roll, tilt = _turn_roll_tilt(rotation_from_vector(pose[..., 3:6].double())).unbind(-1)
    x, y, z = (1 / METRES_PER_UNIT * pose[..., :3].double()).unbind(-1)
    root = dict(zip(_ROOT, (y, x, z, *(a / RADIANS_PER_UNIT for a in (turn, roll, tilt))), strict=True))
    columns = [angles[name] / RADIANS_PER_UNIT if name in angles else root[name] for name in names]
    values = torch.stack(columns, -1).round().long()
    back = pose_of_baps(values, numbering, side)[..., 6:]
    return BapValues(names=names, values=values, residual=pose[..., 6:] - back.to(pose))


def pose_of_baps(values: Int[Tensor, "*batch parameters"], numbering: Numbering, side: Side) -> Float[Tensor, "*b 36"]:
    """Our poses of the values in the order of `bap_ids`, float64; angles without a parameter are zero."""
    names = tuple(bap_ids(numbering, side))
    column = {name: values[..., i].double() for i, name in enumerate(names)}
    pose = torch.zeros(*values.shape[:-1], len(DOFS), dtype=torch.float64, device=values.device)
    for dof in JOINT_DOFS:
        if dof in column:
            pose[..., DOFS.index(dof)] = RADIANS_PER_UNIT * column[dof]
    for place, name in enumerate(("tr_lateral", "tr_vertical", "tr_frontal")):
        pose[..., place] = METRES_PER_UNIT * column[name]
    angles = [RADIANS_PER_UNIT * column[name] for name in _ROOT[3:]]
    axes = torch.eye(3, dtype=torch.float64, device=values.device)[[1, 2, 0]]
    turn, roll, tilt = (rotation_from_vector(a[..., None] * axis) for a, axis in zip(angles, axes, strict=True))
    pose[..., 3:6] = vector_from_rotation(turn @ roll @ tilt)
    return pose


def _turn_roll_tilt(rotation: Float[Tensor, "*batch 3 3"]) -> Float[Tensor, "*batch 3"]:
    """Angles about y, z and x whose rotations multiply to this in that order."""
    turn = torch.atan2(-rotation[..., 2, 0], rotation[..., 0, 0])
    roll = torch.asin(rotation[..., 1, 0].clamp(-1, 1))
    tilt = torch.atan2(-rotation[..., 1, 2], rotation[..., 1, 1])
    is_upright = torch.hypot(rotation[..., 0, 0], rotation[..., 2, 0]) < 1e-9  # turn and tilt about one line
    alone = torch.atan2(rotation[..., 0, 2], rotation[..., 2, 2])
    turn = torch.where(is_upright, alone, turn)
    tilt = torch.where(is_upright, torch.zeros_like(tilt), tilt)
    return torch.stack((turn, roll, tilt), -1)
