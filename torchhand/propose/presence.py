"""Whether a view shows a hand at all: a small network that has seen hands and other things of the simulator."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from torchhand.hand import HandKinematics, HandPose
from torchhand.propose.hypotheses import Silhouette
from torchhand.propose.network import picture_layers
from torchhand.propose.posture import channels_about


class PresenceNetwork(nn.Module):
    """Convolutions as of the proposals, narrower, and two layers to one number."""

    def __init__(self, *, width: int = 8, hidden: int = 96) -> None:
        """Raises ValueError for numbers that make no network."""
        super().__init__()
        for name, value in (("width", width), ("hidden", hidden)):
            if not 1 <= value <= 4096:
                raise ValueError(f"{name}: expected 1 to 4096, got {value}")
        self.sizes = {"width": width, "hidden": hidden}
        self.picture, seen = picture_layers(width)
        self.summary = nn.Sequential(nn.Flatten(), nn.Linear(seen, hidden), nn.ReLU(), nn.Linear(hidden, 1))

    def forward(self, channels: Float[Tensor, "n channels side side"]) -> Float[Tensor, "n"]:
        """Logarithm of how much likelier each view, as `network_channels` shows it, is if it shows a hand than if it
        shows something else of the simulator's."""
        seen = self.picture(channels.contiguous(memory_format=torch.channels_last))
        return self.summary(seen.contiguous()).squeeze(-1)


def hand_presence(
    network: PresenceNetwork,
    silhouette: Silhouette,
    kinematics: HandKinematics,
    pose: HandPose,
    shape: Float[Tensor, "shape"],
) -> Float[Tensor, ""]:
    """Logarithm of how much likelier the picture about a hand at `pose` () in the world is if a hand is there than if
    something else of the simulator's is, seen as `learned_posture` sees it.

    Raises ValueError for a camera that is no pinhole camera.
    """
    return network(channels_about(silhouette, kinematics, pose, shape)[0])[0].to(pose.dofs)
