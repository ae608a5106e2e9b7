"""A small convolutional network from a view of a silhouette to several weighted postures and places of a hand."""

import itertools
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from torchhand.geometry import rotation_from_columns
from torchhand.hand import JOINT_DOFS, ROOT_DOFS, Skeleton, named_pose_space
from torchhand.propose.channels import CHANNELS
from torchhand.propose.views import SIDE_PX

_ROOT = len(ROOT_DOFS)
_SPACE = "dof27"
_ROTATION, _PLACE = 6, 3
_LEAST_SPREAD, _MOST_SPREAD = 0.03, 1.0


@dataclass(frozen=True, kw_only=True)
class ViewedHands:
    """Right hands as a square view shows them: several hypotheses for each view."""

    rotation: Float[Tensor, "*batch k 3 3"]
    """view_from_hand"""
    joints: Float[Tensor, "*batch k 30"]
    """Joint angles within their limits, radians."""
    place: Float[Tensor, "*batch k 2"]
    """Middle of the palm in the square, -1 to 1 from edge to edge."""
    log_size: Float[Tensor, "*batch k"]
    """Logarithm of the hand's length, over what half the side of the square is at the palm's distance."""
    spread: Float[Tensor, "*batch k"]
    """Error that the network expects if the hypothesis is the right one; of the order of the keypoints' in dm."""
    log_weight: Float[Tensor, "*batch k"]
    """Logarithms of the probabilities that each hypothesis is the one nearest to the truth."""


class ProposalNetwork(nn.Module):
    """Convolutions, two layers, and for each hypothesis a rotation, the angles of the 27-DOF space and a place.

    Angles are bounded by sigmoids; a rotation is two columns made orthogonal (Zhou et al. 2019, On the Continuity of
    Rotation Representations in Neural Networks). The weights are those of a mixture density network (Bishop 1994).
    """

    def __init__(self, skeleton: Skeleton, *, hypotheses: int = 8, width: int = 24, hidden: int = 384) -> None:
        """Raises ValueError for numbers that make no network."""
        super().__init__()
        for name, value in (("hypotheses", hypotheses), ("width", width), ("hidden", hidden)):
            if not 1 <= value <= 4096:
                raise ValueError(f"{name}: expected 1 to 4096, got {value}")
        self.sizes = {"hypotheses": hypotheses, "width": width, "hidden": hidden}
        space = named_pose_space(_SPACE, dtype=torch.float32)
        free = [JOINT_DOFS.index(name) for name in space.free_names if name not in ROOT_DOFS]
        self.joint_basis: Tensor
        self.lower: Tensor
        self.upper: Tensor
        self.register_buffer("joint_basis", space.basis[_ROOT:, _ROOT:].clone(), persistent=False)
        self.register_buffer("lower", skeleton.lower[free].float(), persistent=False)
        self.register_buffer("upper", skeleton.upper[free].float(), persistent=False)
        self.outputs = (_ROTATION, len(free), _PLACE, 1, 1)
        self.picture, seen = picture_layers(width)
        self.summary = nn.Sequential(
            nn.Flatten(), nn.Linear(seen, hidden), nn.ReLU(), nn.Linear(hidden, hidden), nn.ReLU()
        )
        self.heads = nn.Linear(hidden, hypotheses * sum(self.outputs))

    def forward(self, channels: Float[Tensor, "n channels side side"]) -> ViewedHands:
        """Hypotheses for each view, as `network_channels` shows it."""
        seen = self.picture(channels.contiguous(memory_format=torch.channels_last))
        found = self.heads(self.summary(seen.contiguous())).unflatten(-1, (self.sizes["hypotheses"], -1))
        turn, angles, place, spread, weight = found.split(self.outputs, -1)
        within = self.lower + (self.upper - self.lower) * torch.sigmoid(angles)
        return ViewedHands(
            rotation=rotation_from_columns(turn),
            joints=within @ self.joint_basis.T,
            place=place[..., :2],
            log_size=place[..., 2],
            spread=_LEAST_SPREAD + (_MOST_SPREAD - _LEAST_SPREAD) * torch.sigmoid(spread.squeeze(-1)),
            log_weight=weight.squeeze(-1).log_softmax(-1),
        )


def picture_layers(width: int) -> tuple[nn.Sequential, int]:
    """Four stages of convolutions of a view, each at half the size and with twice the channels of the one before, from
    `width` on; and how many numbers come out."""
    channels = (width, 2 * width, 4 * width, 8 * width)
    layers: list[nn.Module] = [*_convolution(CHANNELS, channels[0], 5, stride=2)]
    for before, after in itertools.pairwise(channels):
        layers += [*_convolution(before, after, 3, stride=2), _Block(after)]
    return nn.Sequential(*layers), channels[-1] * (SIDE_PX // 16) ** 2


class _Block(nn.Module):
    """Two convolutions whose result is added to what they are given."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.inside = nn.Sequential(
            *_convolution(width, width, 3), nn.Conv2d(width, width, 3, padding=1, bias=False), nn.BatchNorm2d(width)
        )

    def forward(self, given: Tensor) -> Tensor:
        return torch.relu(given + self.inside(given))


def _convolution(before: int, after: int, size: int, *, stride: int = 1) -> tuple[nn.Module, nn.Module, nn.Module]:
    convolution = nn.Conv2d(before, after, size, stride=stride, padding=size // 2, bias=False)
    return convolution, nn.BatchNorm2d(after), nn.ReLU(inplace=True)
