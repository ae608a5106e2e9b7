"""Crops of the simulator, with what is true of them."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from torchhand.hand import HandModel
from torchhand.learn import Samples
from torchhand.propose import SIDE_PX
from torchhand.simulate import CropMaker, CropSettings

LOOKS = CropSettings(side_px=SIDE_PX, left=0.0, blur_px=(0.3, 0.8), roll_deg=25.0)
_PEOPLE = 16


@dataclass(frozen=True, kw_only=True)
class SimulatedCrops:
    """Right hands; what else there is of crops is not kept."""

    image: UInt8[Tensor, "crops side side 3"]
    intrinsics: Float[Tensor, "crops 3 3"]
    keypoints: Float[Tensor, "crops 21 3"]
    """Keypoints in the camera frame, metres."""
    joints: Float[Tensor, "crops 30"]

    def __len__(self) -> int:
        return len(self.image)

    def samples(self, rows: Tensor) -> Samples:
        """The truth of some, as the loss of the network from points has it."""
        keypoints = self.keypoints[rows]
        return Samples(
            points_plane=keypoints[..., :2] / keypoints[..., 2:],
            seen=torch.ones(keypoints.shape[:-1], dtype=torch.bool),
            keypoints=keypoints,
            joints=self.joints[rows],
        )


def simulated_crops(
    model: HandModel, count: int, generator: torch.Generator, tick: Callable[[int], object] = lambda count: None
) -> SimulatedCrops:
    """Crops of hands of the prior. tick: is told how many are ready, a few dozens at a time."""
    parts: list[SimulatedCrops] = []
    for crops in CropMaker(model, LOOKS, generator).batches(_PEOPLE, generator):
        own = crops.rows(slice(count))
        parts.append(
            SimulatedCrops(
                image=own.image, intrinsics=own.intrinsics, keypoints=own.keypoints, joints=own.pose[:, 6:].clone()
            )
        )
        tick(len(own))
        count -= len(own)
        if count <= 0:
            break
    names = ("image", "intrinsics", "keypoints", "joints")
    return SimulatedCrops(**{name: torch.cat([getattr(part, name) for part in parts]) for name in names})
