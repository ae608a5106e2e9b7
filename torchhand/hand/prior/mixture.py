"""A density over joint angles on the feasible set: a mixture of postures, each a chain of truncated normals."""

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from torchhand.hand.kinematics import DOFS, JOINT_DOFS
from torchhand.hand.limits import ABDUCTIONS, FLEXIONS, NEIGHBOUR_BANDS_DEG, TIES, PoseConstraints
from torchhand.hand.prior.components import SLOPES, PostureComponent
from torchhand.numerics import truncated_normal_log_prob, truncated_normal_quantile
from torchhand.precision import own_precision, require_exact

_ROOT = len(DOFS) - len(JOINT_DOFS)
_COUNT = len(JOINT_DOFS)


class PostureMixture(nn.Module):
    """p(joints) = Σ weight_k Π_a N(θ_a; μ_ka(θ before a), σ_ka) cut off to what the hard constraints leave θ_a.

    Angles come in the order of JOINT_DOFS. What is left to each depends on the ones before it only: static limits, the
    MCP flexions within the bands of the finger before, the abductions within what equation (2) leaves at that flexion.
    So every sample is feasible and the density is normalised exactly, without any constant to estimate. The means
    follow the angles before: neighbouring fingers bend together, and the soft ties of Ouhaddi and Horain 1998
    (equations 1, 4, 5) enter as second opinions, two normals multiplied. With hard ties the angles that follow carry no
    density.

    The root has none either: it is uniform, which is improper.
    """

    def __init__(self, constraints: PoseConstraints, components: tuple[PostureComponent, ...]) -> None:
        super().__init__()
        if not components:
            raise ValueError("components: expected at least one posture")
        skeleton = constraints.skeleton
        if constraints.vanishes_at <= float(skeleton.upper[list(FLEXIONS)].max()):
            raise ValueError(
                "abduction_vanishes_at_deg: expected beyond the limits of MCP flexion, so that a density is left to the"
                f" abductions; got {constraints.settings.abduction_vanishes_at_deg}"
            )
        self.constraints = constraints
        self.names = tuple(component.name for component in components)
        means = torch.stack([component.mean for component in components])
        stds = torch.stack([component.std for component in components])
        slopes = torch.zeros(_COUNT, _COUNT, dtype=torch.float64)
        for (target, source), slope in SLOPES.items():
            slopes[JOINT_DOFS.index(target), JOINT_DOFS.index(source)] = slope
        if bool(slopes.triu().any()):
            raise ValueError("slopes: expected angles to follow earlier ones of JOINT_DOFS only")
        tied = torch.zeros_like(stds)  # share of the tie's opinion
        for tie, spread in zip(TIES, constraints.settings.tie_spread, strict=True):
            tied[:, tie.target] = stds[:, tie.target] ** 2 / (stds[:, tie.target] ** 2 + spread**2)
        weights = torch.tensor([component.weight for component in components], dtype=torch.float64)
        self.log_weight: Tensor
        self.offset: Tensor
        self.slopes: Tensor
        self.std: Tensor
        self.tied: Tensor
        self.register_buffer("log_weight", (weights / weights.sum()).log(), persistent=False)
        self.register_buffer("offset", means - means @ slopes.T, persistent=False)
        self.register_buffer("slopes", slopes, persistent=False)
        self.register_buffer("std", stds * (1 - tied).sqrt(), persistent=False)
        self.register_buffer("tied", tied, persistent=False)
        self._is_hard = constraints.settings.ties == "hard"
        targets = {tie.target for tie in TIES} if self._is_hard else set()
        self._free = [index for index in range(_COUNT) if index not in targets]
        self._ranges = _reachable(constraints)

    @own_precision
    def log_prob(self, pose: Float[Tensor, "*batch 36"]) -> Float[Tensor, "*batch"]:
        """Log density, minus infinity outside the hard constraints; its gradient inside is finite."""
        feasible = self.constraints.is_feasible(pose)
        return torch.where(feasible, self.log_density(pose), -torch.inf)

    @own_precision
    def log_density(self, pose: Float[Tensor, "*batch 36"]) -> Float[Tensor, "*batch"]:
        """The same formula without the wall: equal to `log_prob` where that is finite, finite and continuous elsewhere.

        Outside it falls off as the normals do; what is cut off is reckoned at the nearest angles within the limits.
        """
        return torch.logsumexp(self.component_log_density(pose) + self.log_weight.to(pose), -1)

    @own_precision
    def component_log_density(self, pose: Float[Tensor, "*batch 36"]) -> Float[Tensor, "*batch components"]:
        """`log_density` of each posture by itself, weights left out."""
        joints = pose[..., _ROOT:]
        low, high = self.intervals(joints)
        mean = self.offset.to(joints) + (joints @ self.slopes.to(joints).T)[..., None, :]
        wanted = list(torch.zeros_like(joints).unbind(-1))
        for index, tie in enumerate(TIES):
            wanted[tie.target] = self.constraints.tied_angle(index, joints)
        mean = mean + self.tied.to(joints) * (torch.stack(wanted, -1)[..., None, :] - mean)
        free = self._free
        density = truncated_normal_log_prob(
            joints[..., None, free],
            mean[..., free],
            self.std.to(joints)[:, free],
            low[..., None, free],
            high[..., None, free],
        )
        return density.sum(-1)

    def intervals(
        self, joints: Float[Tensor, "*batch 30"]
    ) -> tuple[Float[Tensor, "*batch 30"], Float[Tensor, "*batch 30"]]:
        """What the hard constraints leave each angle, given those before it (taken within their own limits)."""
        skeleton = self.constraints.skeleton
        low = list(skeleton.lower.to(joints).expand_as(joints).unbind(-1))
        high = list(skeleton.upper.to(joints).expand_as(joints).unbind(-1))
        before = None
        flexions = []
        for place, index in enumerate(FLEXIONS):
            low[index], high[index] = self._flexion_interval(place, before, joints[..., index])
            before = torch.minimum(torch.maximum(joints[..., index], low[index]), high[index])
            flexions.append(before)
        start, stop = self.constraints.abduction_limits(torch.stack(flexions, -1))
        for place, index in enumerate(ABDUCTIONS):
            low[index], high[index] = start[..., place], stop[..., place]
        return torch.stack(low, -1), torch.stack(high, -1)

    def sample(
        self, count: int, generator: torch.Generator, *, dtype: torch.dtype | None = None
    ) -> tuple[Float[Tensor, "count 36"], Int[Tensor, "count"]]:
        """Poses with the root at zero, and the posture that each was drawn from (index into `names`).

        Seeded: drawn on the generator's device in float64, given on the module's device and, where `dtype` is None, in
        its dtype.
        """
        dtype = self.offset.dtype if dtype is None else dtype
        require_exact("dtype", dtype)
        device = generator.device
        uniform = torch.rand(count, 1 + _COUNT, generator=generator, dtype=torch.float64, device=device)
        fractions = self.log_weight.double().to(device).exp().cumsum(0)
        kind = torch.searchsorted(fractions, uniform[:, 0].contiguous())
        kind = kind.clamp_max(len(self.names) - 1)
        offset, std, tied = (x.double().to(device)[kind] for x in (self.offset, self.std, self.tied))
        slopes = self.slopes.double().cpu()
        lower, upper = (x.to(device) for x in (self.constraints.skeleton.lower, self.constraints.skeleton.upper))
        joints = torch.zeros(count, _COUNT, dtype=torch.float64, device=device)
        ties = {tie.target: index for index, tie in enumerate(TIES)}
        for index in range(_COUNT):
            mean = offset[:, index]
            for source in slopes[index].nonzero().flatten().tolist():
                mean = mean + float(slopes[index, source]) * joints[:, source]
            if index in ties:
                wanted = self.constraints.tied_angle(ties[index], joints)
                if self._is_hard:
                    joints[:, index] = wanted
                    continue
                mean = mean + tied[:, index] * (wanted - mean)
            low, high = lower[index].expand(count), upper[index].expand(count)
            if index in FLEXIONS:
                place = FLEXIONS.index(index)
                before = joints[:, FLEXIONS[place - 1]] if place else None
                low, high = self._flexion_interval(place, before, mean)
            elif index in ABDUCTIONS:
                place = ABDUCTIONS.index(index)
                limits = self.constraints.abduction_limits(joints[:, list(FLEXIONS)])
                low, high = (limit[:, place] for limit in limits)
            joints[:, index] = truncated_normal_quantile(uniform[:, 1 + index], mean, std[:, index], low, high)
        pose = torch.cat((torch.zeros_like(joints[:, :_ROOT]), joints), -1)
        return pose.to(self.offset.device, dtype), kind.to(self.offset.device)

    def _flexion_interval(self, place: int, before: Tensor | None, like: Tensor) -> tuple[Tensor, Tensor]:
        """Limits of one MCP flexion given the one before; the fingers after it keep some angle."""
        first, last = self._ranges[place]
        low, high = torch.full_like(like, first), torch.full_like(like, last)
        if before is not None:
            band = NEIGHBOUR_BANDS_DEG[self.constraints.settings.bands][place - 1]  # on before − this
            low = torch.maximum(low, before - math.radians(band[1]))
            high = torch.minimum(high, before - math.radians(band[0]))
        return low, high


def _reachable(constraints: PoseConstraints) -> list[tuple[float, float]]:
    """Range of each MCP flexion, index to little, for which the fingers after it have an angle left."""
    limits = [constraints.limits(index) for index in FLEXIONS]
    bands = NEIGHBOUR_BANDS_DEG[constraints.settings.bands]
    ranges = [limits[-1]]
    for place in (2, 1, 0):
        lower, upper = (math.radians(end) for end in bands[place])
        after = ranges[0]
        ranges.insert(0, (max(limits[place][0], after[0] + lower), min(limits[place][1], after[1] + upper)))
    return ranges
