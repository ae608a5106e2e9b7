"""How good a network from pictures is: on simulated hands, on frames of a recording, on pictures with true joints."""

from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from torchhand.files import read_picture
from torchhand.hand import Side
from torchhand.learn import Figures, HandEstimate, figures_of, load_stills
from torchhand.learn.pictures.cutting import cut, mirrored_intrinsics, moved_intrinsics, window_about
from torchhand.learn.pictures.network import PictureNetwork
from torchhand.learn.pictures.recorded import RecordedCrops
from torchhand.learn.pictures.simulated import SimulatedCrops
from torchhand.learn.pictures.teaching import Teacher, part, projected
from torchhand.losses import silhouette_loss

_AT_ONCE = 64

RECORDED_FIGURES = {
    "overlap": "overlap with the silhouette, forearm cut at the wrist",
    "points_px": "distance from the detected points, px of the recording",
}
"""Names of the figures of a recording and what they are; means over crops."""


@dataclass(frozen=True, kw_only=True)
class TrueCrops:
    """Crops of pictures with true joints: right hands, or left ones in the mirror."""

    image: UInt8[Tensor, "crops side side 3"]
    intrinsics: Float[Tensor, "crops 3 3"]
    keypoints: Float[Tensor, "crops 21 3"]
    """Keypoints in the camera frame, metres."""


def still_crops(folder: Path, side: Side) -> TrueCrops:
    """Pictures of a folder with truth.npz and images/, cut around the true points.

    Raises InputError for a folder of another kind.
    """
    stills = load_stills(folder)
    images, intrinsics = [], []
    keypoints = stills.keypoints.float()
    for index, name in enumerate(stills.names):
        window = window_about(stills.points_px[index].float())
        image = torch.from_numpy(cut(read_picture(folder / "images" / name).numpy(), window))
        own = moved_intrinsics(stills.intrinsics[index].float(), window)
        if side == "left":
            image, own = image.flip(1), mirrored_intrinsics(own, image.shape[1])
        images.append(image)
        intrinsics.append(own)
    if side == "left":
        keypoints = keypoints * torch.tensor((-1.0, 1.0, 1.0))
    return TrueCrops(image=torch.stack(images), intrinsics=torch.stack(intrinsics), keypoints=keypoints)


def true_figures(network: PictureNetwork, crops: TrueCrops | SimulatedCrops) -> Figures:
    """Errors by the names of FIGURES."""
    return figures_of(estimated(network, crops.image, crops.intrinsics).keypoints, crops.keypoints)


def recorded_figures(network: PictureNetwork, crops: RecordedCrops, teacher: Teacher) -> Figures:
    """What agrees with the teachers, by the names of RECORDED_FIGURES; crops without a silhouette count for points.

    Network, crops and teacher on one device.
    """
    estimate = estimated(network, crops.image, crops.intrinsics)
    off = (projected(estimate, crops.intrinsics) - crops.points_px).norm(dim=-1).mean(-1) / crops.scale
    told = crops.known.flatten(1).any(1)
    with torch.no_grad():
        covered = [teacher.silhouettes(part(estimate, rows), crops.intrinsics[rows]) for rows in _slices(len(crops))]
    apart = silhouette_loss(torch.cat(covered)[told], crops.mask[told], crops.known[told])
    return {"overlap": 1 - float(apart), "points_px": float(off.mean())}


@torch.no_grad()
def estimated(
    network: PictureNetwork, image: UInt8[Tensor, "crops side side 3"], intrinsics: Float[Tensor, "crops 3 3"]
) -> HandEstimate:
    """Hands of any number of crops, on the network's device."""
    device = network.hands.start.device
    parts = [network(image[rows].to(device), intrinsics[rows].to(device)) for rows in _slices(len(image))]
    names = ("pose", "root_reference", "shape", "keypoints")
    return HandEstimate(**{name: torch.cat([getattr(one, name) for one in parts]) for name in names})


def _slices(count: int) -> list[slice]:
    return [slice(first, first + _AT_ONCE) for first in range(0, count, _AT_ONCE)]
