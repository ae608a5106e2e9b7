"""Pose spaces: affine maps from a few free parameters to the 36 named DOFs."""

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.devices import kept
from torchhand.geometry import rotation_from_vector
from torchhand.hand.kinematics.skeleton import DOFS, FINGERS, JOINT_DOFS, ROOT_DOFS
from torchhand.precision import own_precision


@dataclass(frozen=True, kw_only=True)
class PoseSpace:
    """dof = basis · free + constant.

    The root's rotation is a left perturbation: the rotation vector that comes out is applied on top of a reference
    orientation that the caller keeps (`HandKinematics(..., root_reference=...)`), so no parameter is near a
    singularity. Its constants follow the dtype of the numbers that they meet.
    """

    name: str
    free_names: tuple[str, ...]
    basis: Float[Tensor, "36 free"]
    constant: Float[Tensor, "36"]

    @property
    def size(self) -> int:
        return len(self.free_names)

    @own_precision
    def dof(self, free: Float[Tensor, "*batch free"]) -> Float[Tensor, "*batch 36"]:
        """The full pose of the free parameters."""
        return free @ self.basis.to(free.dtype).T + self.constant.to(free.dtype)

    @property
    def inverse(self) -> Float[Tensor, "free 36"]:
        """Pseudo-inverse of the basis."""
        return torch.linalg.pinv(self.basis) if self.basis.requires_grad else _pseudo_inverse(self.basis)

    @own_precision
    def free(self, dof: Float[Tensor, "*batch 36"]) -> Float[Tensor, "*batch free"]:
        """The free parameters whose pose is nearest (least squares); exact for poses in the space."""
        return (dof - self.constant.to(dof.dtype)) @ self.inverse.to(dof.dtype).T

    @own_precision
    def own(self, dof: Float[Tensor, "*batch 36"]) -> Float[Tensor, "*batch free"]:
        """The free parameters as read off the DOFs that they are named after, whatever the tied ones are.

        What `free` gives for poses in the space; of one whose tied angles have stopped at their limits the free angles
        are kept, where least squares would shift them. Raises ValueError for a parameter that no DOF is named after.
        """
        rows = _rows_of(self.free_names).to(self.basis.device)
        own = self.basis[rows].diagonal()
        return (dof - self.constant.to(dof.dtype))[..., rows] / own.to(dof.dtype)

    def about(self, dof: Float[Tensor, "36"]) -> "PoseSpace":
        """The same directions through another pose: free = 0 gives `dof`, ties are kept as ties of changes."""
        return replace(self, constant=dof)

    def to(self, *, dtype: torch.dtype | None = None, device: torch.device | str | None = None) -> "PoseSpace":
        return replace(
            self, basis=self.basis.to(dtype=dtype, device=device), constant=self.constant.to(dtype=dtype, device=device)
        )


def pose_space(
    name: str,
    free: tuple[str, ...],
    *,
    ties: dict[str, tuple[str, float, float]] | None = None,
    dtype: torch.dtype = torch.float64,
) -> PoseSpace:
    """A space in which the named DOFs are free, and `ties` gives others as dof = factor · free + offset (radians)."""
    basis = torch.zeros(len(DOFS), len(free), dtype=dtype)
    constant = torch.zeros(len(DOFS), dtype=dtype)
    for column, dof in enumerate(free):
        if dof not in DOFS:
            raise _unknown(dof)
        basis[DOFS.index(dof), column] = 1.0
    for dof, (source, factor, offset) in (ties or {}).items():
        if dof not in DOFS:
            raise _unknown(dof)
        if source not in free:
            raise ValueError(f"tie of {dof}: {source!r} is not free; free are {', '.join(free)}")
        basis[DOFS.index(dof), free.index(source)] = factor
        constant[DOFS.index(dof)] = offset
    return PoseSpace(name=name, free_names=free, basis=basis, constant=constant)


@kept(64)
def _rows_of(free_names: tuple[str, ...]) -> Int[Tensor, "free"]:
    """The DOFs that parameters are named after. Raises ValueError for one that no DOF is named after."""
    for name in free_names:
        if name not in DOFS:
            raise ValueError(f"free parameter {name!r} is not named after a DOF; allowed: {', '.join(DOFS)}")
    return torch.tensor([DOFS.index(name) for name in free_names])


@kept(16)
def _pseudo_inverse(basis: Float[Tensor, "36 free"]) -> Float[Tensor, "free 36"]:
    """Computed once for a basis, which all spaces through other poses have in common."""
    return torch.linalg.pinv(basis)


def _unknown(dof: str) -> ValueError:
    return ValueError(f"unknown DOF {dof!r}; allowed: {', '.join(DOFS)}")


def _joints_without(*left_out: str) -> tuple[str, ...]:
    return tuple(dof for dof in JOINT_DOFS if not any(dof.endswith(ending) for ending in left_out))


_DIP_TIES = {
    f"{finger}_dip_fe": (f"{finger}_pip_fe", 2 / 3, 0.0) for finger in FINGERS[1:]
}  # Ouhaddi and Horain 1998, eq. 1
_THUMB_TIE = {"thumb_mcp_fe": ("thumb_cmc_fe", 2.0, -math.pi / 3)}  # Ouhaddi and Horain 1998, equation 4
_ABDUCTIONS = ("thumb_cmc_aa", *(f"{finger}_mcp_aa" for finger in FINGERS[1:]))

POSE_SPACES: dict[str, tuple[tuple[str, ...], dict[str, tuple[str, float, float]]]] = {
    # Stenger et al. 2001, section 5: translation in the picture and rotation about the optical axis
    "planar": (("root_tx", "root_ty", "root_rz"), {}),
    # the same with depth, which is scale in the picture
    "planar_scale": (("root_tx", "root_ty", "root_tz", "root_rz"), {}),
    # Ouhaddi and Horain 1998, sections 7.2 and 9: planar motion, scale and the abductions
    "planar_abduction": (("root_tx", "root_ty", "root_tz", "root_rz", *_ABDUCTIONS), {}),
    # Ouhaddi and Horain 1998 with constraints (1) and (4)
    "dof26": (
        (
            *ROOT_DOFS,
            *(d for d in _joints_without("_dip_fe", "cmc_fe", "thumb_mcp_aa", "thumb_mcp_fe")),
            "thumb_cmc_fe",
        ),
        _DIP_TIES | _THUMB_TIE,
    ),
    # Stenger et al. 2001, section 4.1
    "dof27": ((*ROOT_DOFS, "thumb_cmc_fe", *_joints_without("cmc_fe", "_tw")), {}),
    # Ouhaddi and Horain 1998, section 3.3
    "dof28": ((*ROOT_DOFS, "thumb_cmc_fe", "thumb_cmc_tw", *_joints_without("cmc_fe", "_tw")), {}),
    # Ouhaddi and Horain 1998, section 4, and Ueda et al. 2003
    "dof31": ((*ROOT_DOFS, "thumb_cmc_fe", *_joints_without("cmc_fe", "thumb_mcp_aa")), {}),
    # every angle of the model
    "dof36": (DOFS, {}),
}


def named_pose_space(name: str, *, dtype: torch.dtype = torch.float64) -> PoseSpace:
    """One of POSE_SPACES. Free parameters keep the order of DOFS."""
    if name not in POSE_SPACES:
        raise ValueError(f"unknown pose space {name!r}; allowed: {', '.join(POSE_SPACES)}")
    free, ties = POSE_SPACES[name]
    return pose_space(name, tuple(sorted(free, key=DOFS.index)), ties=ties, dtype=dtype)


_DEG = math.pi / 180

_FIST = {
    **{f"{finger}_mcp_fe": 85.0 for finger in FINGERS[1:]},
    **{f"{finger}_pip_fe": 100.0 for finger in FINGERS[1:]},
    **{f"{finger}_dip_fe": 67.0 for finger in FINGERS[1:]},
    **{"thumb_cmc_fe": 15.0, "thumb_cmc_aa": 8.0, "thumb_mcp_fe": 37.0, "thumb_ip_fe": 72.0},  # over index and middle
}
_SPREAD = {"index_mcp_aa": 12.0, "ring_mcp_aa": 8.0, "little_mcp_aa": 18.0, "thumb_cmc_fe": -10.0, "thumb_cmc_aa": 28.0}


def _fist_but(*straight: str, **angles: float) -> dict[str, float]:
    kept = {dof: angle for dof, angle in _FIST.items() if not dof.startswith(straight)} if straight else dict(_FIST)
    return kept | angles


POSTURES: dict[str, dict[str, float]] = {
    # degrees; design values
    "open": _SPREAD,
    "flat": {"thumb_cmc_aa": 10.0},
    "fist": _FIST,
    "point": _fist_but("index"),
    "victory": _fist_but("index", "middle", index_mcp_aa=12.0, middle_mcp_aa=-4.0),
    "three": _fist_but("index", "middle", "ring", index_mcp_aa=12.0, ring_mcp_aa=8.0),
    "four": _fist_but("index", "middle", "ring", "little", index_mcp_aa=12.0, ring_mcp_aa=8.0, little_mcp_aa=18.0),
    "thumb_up": _fist_but("thumb", thumb_cmc_fe=-15.0, thumb_cmc_aa=40.0),
    "l": _fist_but("thumb", "index", thumb_cmc_fe=-15.0, thumb_cmc_aa=40.0),
    "pinch": {
        **{"thumb_cmc_fe": 16.0, "thumb_cmc_aa": 1.0, "thumb_mcp_fe": 14.0, "thumb_ip_fe": 14.0},
        **{"index_mcp_fe": 47.0, "index_pip_fe": 48.0, "index_dip_fe": 37.0},  # its pad meets the thumb's
        **{"middle_mcp_fe": 27.0, "middle_pip_fe": 27.0, "middle_dip_fe": 18.0},
        **{"ring_mcp_fe": 18.0, "ring_pip_fe": 21.0, "ring_dip_fe": 14.0},
        **{"little_mcp_fe": 11.0, "little_pip_fe": 15.0, "little_dip_fe": 10.0},
    },
    "shaka": _fist_but("thumb", "little", thumb_cmc_fe=-15.0, thumb_cmc_aa=40.0, little_mcp_aa=18.0),
}
"""Named postures: joint angles in degrees, those not named are zero."""


def posture(
    name: str, *, dtype: torch.dtype = torch.float32, device: torch.device | str | None = None
) -> Float[Tensor, "36"]:
    """The named posture as a pose with the root at the origin, radians; in the dtype of `Hand` unless asked."""
    if name not in POSTURES:
        raise ValueError(f"unknown posture {name!r}; allowed: {', '.join(POSTURES)}")
    pose = torch.zeros(len(DOFS), dtype=dtype)
    for dof, angle_deg in POSTURES[name].items():
        pose[DOFS.index(dof)] = angle_deg * _DEG
    return pose.to(device)


@own_precision
def rebased(
    dof: Float[Tensor, "*batch 36"], root_reference: Float[Tensor, "*batch 3 3"]
) -> tuple[Float[Tensor, "*batch 36"], Float[Tensor, "*batch 3 3"]]:
    """Moves the root's rotation from the pose into the reference: the same hand, with a zero rotation vector."""
    turned = rotation_from_vector(dof[..., 3:6]) @ root_reference
    keep = torch.ones(len(DOFS), dtype=dof.dtype, device=dof.device)
    keep[3:6] = 0
    return dof * keep, turned
