"""A small network from a crop of a picture to a hand: convolutions before the network that learns from points."""

import torch
from jaxtyping import Float, UInt8
from torch import Tensor, nn

from torchhand.hand import HandModel
from torchhand.learn import FEATURES, HandEstimate, Observation, PoseNetwork
from torchhand.propose import SIDE_PX, SquareViews, picture_layers, views_towards

_USUAL_SIZE = 0.5
"""Root mean square distance of a hand's points from their middle, over half the side of its crop."""
_LEAST_CONTRAST = 4.0  # grey levels: flatter crops are noise


class PictureNetwork(nn.Module):
    """Right hands from crops of SIDE_PX, in the frames of the cameras that the crops are cut from.

    The crop takes the place of the points: its middle and its size on the image plane are those of the observation,
    and what the convolutions make of its pixels the features.
    """

    def __init__(
        self, model: HandModel, usual_joints: Float[Tensor, "30"], *, width: int, hidden: int, blocks: int
    ) -> None:
        """width: channels after the first convolution. hidden, blocks: those of the layers that follow. usual_joints:
        joint angles from which training starts, radians."""
        super().__init__()
        self.picture, count = picture_layers(width)
        self.features = nn.Linear(count, FEATURES)
        self.hands = PoseNetwork(model, usual_joints, width=hidden, blocks=blocks)

    def forward(
        self, image: UInt8[Tensor, "crops side side 3"], intrinsics: Float[Tensor, "crops 3 3"]
    ) -> HandEstimate:
        """One hand for each crop. intrinsics: of the crop's pixels."""
        views = crop_views(intrinsics)
        pixels = image.movedim(-1, 1).to(intrinsics).contiguous(memory_format=torch.channels_last)
        mean, std = pixels.mean((1, 2, 3), keepdim=True), pixels.std((1, 2, 3), keepdim=True)
        seen = self.picture((pixels - mean) / std.clamp_min(_LEAST_CONTRAST))
        return self.hands(
            Observation(
                features=self.features(seen.contiguous().flatten(1)),
                centre=torch.zeros_like(intrinsics[:, 0, :2]),
                size=_USUAL_SIZE * views.reach,
                cam_from_view=views.cam_from_view,
            )
        )


def crop_views(intrinsics: Float[Tensor, "crops 3 3"]) -> SquareViews:
    """Cameras in the place of the crops' own that look at the crops' middles, upright."""
    middle = intrinsics.new_full((2,), 0.5 * (SIDE_PX - 1))
    focal = torch.stack((intrinsics[:, 0, 0], intrinsics[:, 1, 1]), -1)
    ahead = torch.cat(((middle - intrinsics[:, :2, 2]) / focal, torch.ones_like(focal[:, :1])), -1)
    up = ahead.new_tensor((0.0, -1.0, 0.0)).expand_as(ahead)
    return views_towards(ahead, up, 0.5 * SIDE_PX / focal.mean(-1))
