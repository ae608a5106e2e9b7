"""Joint angles of signs: the nearest to the table's within the limits whose contacts meet and whose parts do not."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.hand import (
    DOFS,
    FINGERS,
    JOINT_DOFS,
    ConstraintSettings,
    HandKinematics,
    Penetration,
    PoseConstraints,
    Primitives,
    penetration,
    place_primitives,
    primitive_sizes,
)
from torchhand.hand.limits import ABDUCTIONS, FLEXIONS, NEIGHBOUR_BANDS_DEG
from torchhand.numerics import LevenbergMarquardtSettings, levenberg_marquardt
from torchhand.signs.places import thumb_asides, thumb_insides, tips_on_thumb
from torchhand.signs.skin_points import POINT_NAMES, skin_points
from torchhand.signs.table import (
    DIP_DEG,
    HANDSHAPES,
    MCP_DEG,
    PIP_DEG,
    SPREAD_DEG,
    SPREAD_WIDE_DEG,
    THUMB_DEG,
    Handshape,
)

_ROOT = len(DOFS) - len(JOINT_DOFS)
# What costs ½ each: metres that points are off their contact, parts overlap or segments do not touch, ...
_CONTACT, _GAP, _DEPTH, _TOUCH = 1.2e-3, 3.6e-3, 0.15e-3, 0.3e-3
_CLEARANCE = 0.1e-3  # parts that are nearer than this repel each other, metres
_CROSSING = 10e-3  # metres that the middle finger's tip lies beyond the index's where they are crossed
_MIDWAY = 1.5e-3  # ... the thumb's tip is off the middle between the planes of two fingers, metres ...
_ASIDE, _INSIDE = 4e-3, 8e-3  # metres that it is within these planes, and within the bend of the finger above it
_ROOM = math.radians(0.5)  # ... radians beyond equation (2), or by which the index bends alone beyond equation (3) ...
# ... and degrees off the table: joints of fingers, of fingers and thumbs that a contact may move, sideways at the
# knuckles, about the bone, of the palm.
_TIGHT_DEG, _FREE_DEG, _THUMB_DEG, _SPREAD_DEG, _TWIST_DEG, _PALM_DEG = 3.0, 18.0, 22.0, 7.0, 10.0, 5.0
_THUMB_AWAY_DEG = {"thumb_cmc_fe": 15.0, "thumb_cmc_aa": 55.0, "thumb_mcp_fe": 5.0, "thumb_ip_fe": 10.0}
_TUCKED_DEG = {
    **{"thumb_cmc_fe": 18.0, "thumb_cmc_aa": 0.0, "thumb_cmc_tw": -15.0, "thumb_mcp_fe": 55.0, "thumb_ip_fe": 31.0},
    **{f"{finger}_{joint}_fe": 60.0 for finger in ("index", "middle") for joint in ("mcp", "pip")},
}
_NOTHING = 1e-12
_INDEX_ALONE = math.radians(NEIGHBOUR_BANDS_DEG["paper"][0][1] - 0.05)  # with room for what the file rounds
_STEP = 1e-6  # radians
_SETTINGS = LevenbergMarquardtSettings(iterations=60, cost_tolerance=1e-6)


@dataclass(frozen=True, kw_only=True)
class SolvedSigns:
    """Joint angles of some signs, and how well they came out."""

    signs: str
    joints: Float[Tensor, "signs 30"]
    """Joint angles, radians, within the limits; the same for left and right hands."""
    contact: Float[Tensor, "signs"]
    """Largest distance of two points that ought to meet, metres; 0 where the sign has none. Points are places on the
    skin: digits may touch beside them."""
    overlap: Penetration
    """Depths of all parts in each other."""


def table_angles(shape: Handshape) -> Float[Tensor, "30"]:
    """The table's design values, radians."""
    angles = dict.fromkeys(JOINT_DOFS, 0.0)
    for finger in FINGERS[1:]:
        code = getattr(shape, finger)
        for joint, degrees, letter in zip(("mcp", "pip", "dip"), (MCP_DEG, PIP_DEG, DIP_DEG), code, strict=True):
            angles[f"{finger}_{joint}_fe"] = degrees[letter]
    to_index, to_ring, to_little = (SPREAD_DEG[gap] for gap in shape.spread)
    angles["index_mcp_aa"] = to_index * SPREAD_WIDE_DEG["index"]
    angles["ring_mcp_aa"] = to_ring * SPREAD_WIDE_DEG["ring"]
    step = SPREAD_WIDE_DEG["little"] - SPREAD_WIDE_DEG["ring"]
    angles["little_mcp_aa"] = to_ring * SPREAD_WIDE_DEG["ring"] + to_little * step
    thumb = THUMB_DEG[shape.thumb] if shape.thumb_deg is None else shape.thumb_deg
    names = ("thumb_cmc_fe", "thumb_cmc_aa", "thumb_mcp_fe", "thumb_ip_fe")
    angles |= dict(zip(names, thumb, strict=True))
    if shape.crossed:
        angles |= {"index_mcp_fe": 18.0, "index_mcp_aa": -12.0, "middle_mcp_aa": 11.0, "middle_mcp_fe": 0.0}
        angles |= {"middle_pip_fe": 12.0, "middle_dip_fe": 8.0}
    return torch.deg2rad(torch.tensor([angles[dof] for dof in JOINT_DOFS], dtype=torch.float64))


def solve_signs(
    kinematics: HandKinematics,
    signs: str,
    shape: Float[Tensor, "shape"] | None = None,
    *,
    start: Float[Tensor, "signs 30"] | None = None,
) -> SolvedSigns:
    """The signs, each of HANDSHAPES, of a right hand of these proportions; deterministic.

    Least squares over the 30 joint angles within their limits: distance to the table, contacts, overlap of parts,
    equation (2) of Ouhaddi and Horain (1998). Tried from four starts, the best is taken; from `start` alone where that
    is given, such as the solution of another hand. kinematics: float64.

    Raises KeyError for a sign that the table lacks.
    """
    rows = [HANDSHAPES[sign] for sign in signs]
    target = torch.stack([table_angles(row) for row in rows])
    problem = _Problem(kinematics, rows, target, shape)
    lower, upper = kinematics.skeleton.lower.double(), kinematics.skeleton.upper.double()
    tries = [
        levenberg_marquardt(problem.linearise, place.clamp(lower, upper), lower=lower, upper=upper, settings=_SETTINGS)
        for place in (_starts(rows, target) if start is None else [start])
    ]
    best = torch.stack([found.cost for found in tries]).argmin(0)
    joints = torch.stack([found.values for found in tries])[best, torch.arange(len(rows))]
    pose = torch.cat((joints.new_zeros(len(rows), _ROOT), joints), -1)
    return problem.evaluated(signs, problem.constraints.project(pose)[:, _ROOT:])


def _starts(rows: Sequence[Handshape], target: Float[Tensor, "signs 30"]) -> list[Float[Tensor, "signs 30"]]:
    """The table, the same with the thumb away from the palm, with fingers half open, and, of signs that have the thumb
    between fingers, with the thumb below fingers that are half open."""
    half_open = target.clone()
    half_open[:, [i for i, dof in enumerate(JOINT_DOFS) if not dof.startswith("thumb") and dof.endswith("fe")]] *= 0.6
    away, tucked = target.clone(), target.clone()
    is_tucked = torch.tensor([row.between is not None for row in rows])
    for start, which, changes in (
        (away, torch.ones_like(is_tucked), _THUMB_AWAY_DEG),
        (tucked, is_tucked, _TUCKED_DEG),
    ):
        for dof, degrees in changes.items():
            start[which, JOINT_DOFS.index(dof)] = math.radians(degrees)
    return [target, away, half_open, tucked]


def _spreads(shape: Handshape) -> Float[Tensor, "30"]:
    """How far each joint may be off the table at a cost of ½, radians."""
    has_contact = bool(shape.meet or shape.touch or shape.gap or shape.rest)
    spread = []
    for dof in JOINT_DOFS:
        finger, joint = dof.split("_", 1)
        if joint == "mcp_aa":
            value = _SPREAD_DEG
        elif finger == "thumb":
            is_stiff = not has_contact or (shape.straight_thumb and not joint.startswith("cmc"))
            value = _TIGHT_DEG if is_stiff else _THUMB_DEG
        elif joint in ("mcp_tw", "cmc_fe"):
            value = _TWIST_DEG if joint == "mcp_tw" else _PALM_DEG
        else:
            value = _FREE_DEG if finger in shape.free else _TIGHT_DEG
        spread.append(math.radians(value))
    return torch.tensor(spread, dtype=torch.float64)


def _sides(rows: Sequence[Handshape]) -> tuple[Float[Tensor, "signs 4"], Float[Tensor, "signs 4"]]:
    """Ones at the finger that is bent over the thumb's tip, and at the one behind it."""
    above, below = torch.zeros(2, len(rows), len(FINGERS) - 1, dtype=torch.float64)
    for i, row in enumerate(rows):
        if row.between is not None:
            above[i, FINGERS.index(row.between[0]) - 1] = below[i, FINGERS.index(row.between[1]) - 1] = 1
    return above, below


class _Problem:
    """Residuals of some signs at once; the tables of contacts have a row per sign."""

    def __init__(
        self,
        kinematics: HandKinematics,
        rows: Sequence[Handshape],
        target: Float[Tensor, "signs 30"],
        shape: Float[Tensor, "shape"] | None,
    ) -> None:
        self.constraints = PoseConstraints(kinematics.skeleton, ConstraintSettings(bands="none"))
        self._kinematics = kinematics
        self._shape = kinematics.default_shape.double() if shape is None else shape.double()
        self._sizes = primitive_sizes(kinematics.shape_space, self._shape)
        names = penetration(self._placed(target[0])).names
        count, width = len(rows), max(1, *(len(row.meet) + len(row.gap) for row in rows))
        first, second = (torch.zeros(count, width, dtype=torch.long) for _ in range(2))
        meets, gaps = torch.zeros(count, width, dtype=torch.float64), torch.full((count, width), -1.0).double()
        touches = torch.zeros(count, len(names), dtype=torch.float64)
        for i, row in enumerate(rows):
            pairs = [(*pair, None) for pair in row.meet] + list(row.gap)
            for k, (one, other, distance) in enumerate(pairs):
                first[i, k], second[i, k] = POINT_NAMES.index(one), POINT_NAMES.index(other)
                meets[i, k] = float(distance is None)
                gaps[i, k] = -1.0 if distance is None else distance
            for one, other in row.touch:
                name = f"{one} – {other}"
                touches[i, names.index(name if name in names else f"{other} – {one}")] = 1
        crossed = torch.tensor([[float(row.crossed)] for row in rows], dtype=torch.float64)
        spread = torch.stack([_spreads(row) for row in rows])
        self._first, self._second, self._meets = first, second, meets
        rests = torch.tensor([[float(finger in row.rest) for finger in FINGERS[1:]] for row in rows]).double()
        self._given = (target, spread, meets, gaps, touches, crossed)
        self._thumb = (rests, *_sides(rows))

    def _placed(self, joints: Float[Tensor, "*batch 30"]) -> Primitives:
        pose = torch.cat((joints.new_zeros(*joints.shape[:-1], _ROOT), joints), -1)
        return place_primitives(self._kinematics(pose, self._shape), self._sizes)

    def _thumb_residuals(self, primitives: Primitives) -> Float[Tensor, "signs steps residuals"]:
        """Fingertips on the thumb, the thumb's tip between two fingers."""
        rests, above, below = (x[:, None] for x in self._thumb)
        aside = thumb_asides(primitives)
        return torch.cat(
            (
                rests * tips_on_thumb(primitives) / _TOUCH,
                ((above + below) * aside).sum(-1, keepdim=True) / _MIDWAY,
                above * (_ASIDE + aside).clamp_min(0) / _CONTACT,
                below * (_ASIDE - aside).clamp_min(0) / _CONTACT,
                above * (_INSIDE - thumb_insides(primitives)).clamp_min(0) / _CONTACT,
            ),
            -1,
        )

    def _residuals(self, joints: Float[Tensor, "signs steps 30"]) -> Float[Tensor, "signs steps residuals"]:
        target, spread, meets, gaps, touches, crossed = (x[:, None] for x in self._given)
        primitives = self._placed(joints)
        points, overlap = skin_points(primitives), penetration(primitives)
        between = self._between(points)
        distance = (between.square().sum(-1) + _NOTHING).sqrt()
        low, high = self.constraints.abduction_limits(joints[..., list(FLEXIONS)])
        aside = joints[..., list(ABDUCTIONS)]
        index, middle = (joints[..., place] for place in FLEXIONS[:2])
        index_tip, middle_tip = (points[..., POINT_NAMES.index(f"{finger}_tip"), 2] for finger in ("index", "middle"))
        return torch.cat(
            (
                (joints - target) / spread,
                (meets[..., None] * between / _CONTACT).flatten(2),
                torch.where(gaps > 0, (distance - gaps) / _GAP, 0.0),
                (overlap.depth + _CLEARANCE).clamp_min(0) / _DEPTH,
                touches * overlap.depth / _TOUCH,
                ((low - aside).clamp_min(0) + (aside - high).clamp_min(0)) / _ROOM,
                (index - middle - _INDEX_ALONE).clamp_min(0)[..., None] / _ROOM,
                crossed * (index_tip - middle_tip + _CROSSING)[..., None].clamp_min(0) / _CONTACT,
                self._thumb_residuals(primitives),
            ),
            -1,
        )

    def _between(self, points: Float[Tensor, "signs steps points 3"]) -> Float[Tensor, "signs steps contacts 3"]:
        rows = torch.arange(len(points))[:, None]
        return (points[rows, :, self._first] - points[rows, :, self._second]).transpose(1, 2)

    def linearise(
        self, joints: Float[Tensor, "signs 30"]
    ) -> tuple[Float[Tensor, "signs residuals"], Float[Tensor, "signs residuals 30"]]:
        """Residuals and their Jacobian, by differences: all signs and steps in one batch."""
        values = self._residuals(
            joints[:, None]
            + torch.cat((torch.zeros(1, len(JOINT_DOFS)), _STEP * torch.eye(len(JOINT_DOFS)))).to(joints)
        )
        return values[:, 0], ((values[:, 1:] - values[:, :1]) / _STEP).mT

    def evaluated(self, signs: str, joints: Float[Tensor, "signs 30"]) -> SolvedSigns:
        primitives = self._placed(joints)
        points, overlap = skin_points(primitives), penetration(primitives)
        distance = self._between(points[:, None])[:, 0].norm(dim=-1)
        return SolvedSigns(signs=signs, joints=joints, contact=(distance * self._meets).amax(-1), overlap=overlap)
