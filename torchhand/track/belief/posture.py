"""A weak posture prior as linear measurements of the free parameters, for what a contour does not tell."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.devices import sent_to
from torchhand.geometry import vector_from_rotation
from torchhand.hand import DOFS, PoseSpace
from torchhand.track.belief.settings import PosturePriorSettings

_TIE = 2.0 / 3.0  # flexion of the end joint over that of the middle joint (Ouhaddi and Horain 1998, eq. 1)
_SIDE_STD = 0.12  # radians: standard deviation of abductions and twists about those of the start
_TILTS = ("root_rx", "root_ry")


@dataclass(frozen=True, kw_only=True)
class PostureMeasurements:
    """Beliefs `matrix` · free = value with independent errors."""

    matrix: Float[Tensor, "rows free"]
    variance: Float[Tensor, "rows"]
    """Variances, radians squared."""
    tilts: tuple[tuple[int, int], ...]
    """(row, axis of the camera) of the beliefs about the tilt since the start."""
    is_tie: Bool[Tensor, "rows"]
    """Beliefs that hold for every posture; the others say that a hand stays like that of the start, for want of
    anything that tells."""

    is_rest: Bool[Tensor, "rows"]
    """Beliefs that flexions stay those of the start."""

    def value(self, reference: Float[Tensor, "3 3"], start_reference: Float[Tensor, "3 3"]) -> Float[Tensor, "rows"]:
        """Values that the prior expects of a hand whose rotation is a left perturbation of `reference`, radians.

        Both are cam_from_hand: now, and at the start.
        """
        value = torch.zeros_like(self.variance)
        if self.tilts:
            turned = vector_from_rotation(reference @ start_reference.T)
            for row, axis in self.tilts:
                value[row] = -turned[axis]
        return value


def posture_prior(space: PoseSpace, settings: PosturePriorSettings, *, has_tilt: bool) -> PostureMeasurements:
    """The prior on the free parameters of a pose space, which count changes from the start; float64.

    has_tilt: whether there is a measurement of the rotation out of the picture's plane, which is that of the world's z.
    """
    rows: list[Tensor] = []
    variances: list[float] = []
    ties: list[bool] = []
    rests: list[bool] = []
    tilts: list[tuple[int, int]] = []
    names = space.free_names
    for i, name in enumerate(names):
        row = torch.zeros(len(names), dtype=torch.float64)
        row[i] = 1.0
        middle_joint = name.replace("dip", "pip")
        if name in _TILTS:
            if not has_tilt:
                continue
            tilts.append((len(rows), DOFS.index(name) - 3))
            std = settings.tilt_std_rad
        elif name.startswith("root_"):
            continue
        elif name.endswith("_dip_fe") and middle_joint in names:
            row[names.index(middle_joint)] = -_TIE
            std = settings.tie_std_rad
        elif name.endswith(("_aa", "_tw")):
            std = _SIDE_STD
        else:
            std = settings.rest_std_rad
        is_tie = name.endswith("_dip_fe") and middle_joint in names
        ties.append(is_tie)
        rests.append(name.endswith("_fe") and not is_tie)
        rows.append(row)
        variances.append(std**2)
    matrix = torch.stack(rows) if rows else torch.zeros(0, len(names), dtype=torch.float64)
    told = PostureMeasurements(
        matrix=matrix,
        variance=torch.tensor(variances, dtype=torch.float64),
        tilts=tuple(tilts),
        is_tie=torch.tensor(ties, dtype=torch.bool),
        is_rest=torch.tensor(rests, dtype=torch.bool),
    )
    return sent_to(told, space.basis.device)
