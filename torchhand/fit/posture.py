"""The posture prior as least squares: of its mixture, the posture that is likeliest, without the cut-offs.

The mixture's components are chains of normals whose means follow the angles before them, so that minus the logarithm
of one is half a sum of squares of linear residuals, but for the clamps of the ties and the normalisation of what is cut
off at the limits.
"""

from dataclasses import dataclass, fields
from functools import cached_property

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchhand.hand import DOFS, JOINT_DOFS, PostureMixture
from torchhand.hand.limits import TIES

_ROOT = len(DOFS) - len(JOINT_DOFS)


@dataclass(frozen=True, kw_only=True)
class PostureResiduals:
    """Residuals matrix · joints - offset of each of the mixture's postures."""

    matrix: Float[Tensor, "postures 30 30"]
    offset: Float[Tensor, "postures 30"]
    level: Float[Tensor, "postures"]
    """Minus the logarithm of weight and normalisation, up to one constant."""

    @classmethod
    def of(cls, mixture: PostureMixture) -> "PostureResiduals":
        """Residuals of a mixture with soft ties, float64."""
        if mixture.constraints.settings.ties == "hard":
            raise ValueError("mixture: expected soft ties; with hard ones the tied angles have no density")
        slopes, std, tied = mixture.slopes.double(), mixture.std.double(), mixture.tied.double()
        follows, wanted = torch.zeros_like(slopes), torch.zeros_like(slopes[0])
        for tie in TIES:
            follows[tie.target, tie.source] = tie.factor
            wanted[tie.target] = tie.offset
        own = 1 - tied
        identity = torch.eye(len(JOINT_DOFS), dtype=torch.float64, device=slopes.device)
        expected = own[:, :, None] * slopes + tied[:, :, None] * follows
        return cls(
            matrix=(identity - expected) / std[:, :, None],
            offset=(own * mixture.offset.double() + tied * wanted) / std,
            level=std.log().sum(-1) - mixture.log_weight.double(),
        )

    def on(self, device: torch.device) -> "PostureResiduals":
        """The same residuals on a device; sent there once."""
        if self.matrix.device == device:
            return self
        if device not in self._sent:
            with torch.inference_mode(False):  # kept for callers in any mode
                sent = {field.name: getattr(self, field.name).to(device) for field in fields(self)}
            self._sent[device] = PostureResiduals(**sent)
        return self._sent[device]

    @cached_property
    def _sent(self) -> "dict[torch.device, PostureResiduals]":
        return {}

    def likeliest(self, pose: Float[Tensor, "*batch 36"]) -> Int[Tensor, "*batch"]:
        """The posture of highest density at each pose."""
        joints = pose[..., _ROOT:].to(self.matrix)
        missed = (joints @ self.matrix.flatten(0, 1).T).unflatten(-1, self.offset.shape) - self.offset
        return (0.5 * missed.square().sum(-1) + self.level).argmin(-1)

    def nearest(self, pose: Float[Tensor, "k 36"], spread: float, count: int) -> Float[Tensor, "k count 30"]:
        """Joint angles that are expected in each of the likeliest postures, where those given are off by normal errors.

        spread: standard deviation of the errors of all angles, radians. Of a normal density with covariance C about m,
        errors leave that with C + spread² about m, and the expected angles are m + C (C + spread²)⁻¹ (given - m).
        """
        joints, inverse = pose[:, _ROOT:].to(self.matrix), torch.linalg.inv(self.matrix)
        away = joints[:, None] - (inverse @ self.offset[..., None]).squeeze(-1)
        own = inverse @ inverse.mT
        blurred = own + spread**2 * torch.eye(own.shape[-1], dtype=own.dtype, device=own.device)
        pull = torch.linalg.solve(blurred, away.permute(1, 2, 0)).permute(2, 0, 1)
        level = self.level + 0.5 * (torch.logdet(blurred) - torch.logdet(own))
        cost = 0.5 * (away * pull).sum(-1) + level
        chosen = cost.topk(min(count, cost.shape[1]), largest=False).indices
        pull = pull.gather(1, chosen[..., None].expand(-1, -1, pull.shape[2]))
        return (joints[:, None] - spread**2 * pull).to(pose)

    def of_joints(
        self, pose: Float[Tensor, "*batch 36"], posture: Int[Tensor, "*batch"]
    ) -> tuple[Float[Tensor, "*batch 30"], Float[Tensor, "*batch 30 30"]]:
        """Residuals of a posture that is held, in standard deviations, and their derivative in the joint angles."""
        joints = pose[..., _ROOT:]
        matrix = self.matrix.to(joints)[posture]
        return (matrix @ joints[..., None]).squeeze(-1) - self.offset.to(joints)[posture], matrix
