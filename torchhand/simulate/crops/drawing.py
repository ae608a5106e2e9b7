"""Pictures of crops' hands: skin and sleeves of many colours under many lights."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.devices import constant_tensor
from torchhand.geometry import assumed_camera
from torchhand.simulate.crops.draws import Draws
from torchhand.simulate.crops.hands import HAND, CropHands, last_labels
from torchhand.simulate.crops.settings import CropSettings
from torchhand.simulate.scene import SKIN_TONES
from torchhand.view import rasterize_many

_FOCAL = 1.0  # of the camera that all crops share, over the crop's side
_LIGHT_FROM, _LIGHT_SPREAD = (0.0, -0.4, -1.0), (0.8, 0.8, 0.3)  # camera frame: towards the light, and how that varies


@dataclass(frozen=True, kw_only=True)
class DrawnHands:
    """Hands without what is behind and before them."""

    is_hand: Bool[Tensor, "crops side side"]
    """Pixels of the hand, without its forearm."""
    depth: Float[Tensor, "crops side side"]
    """z of hand and forearm in the camera frame, metres; 0 beside."""
    pixel: Int[Tensor, "drawn"]
    """Pixels of hand and forearm, in the flat list of all crops' pixels."""
    colour: Float[Tensor, "drawn 3"]
    """RGB of these, 0 to 255."""

    def before(self, pictures: Float[Tensor, "crops side side 3"]) -> Float[Tensor, "crops side side 3"]:
        """The pictures with the hands drawn into them."""
        pictures.view(-1, 3).index_copy_(0, self.pixel, self.colour)
        return pictures


def drawn_hands(hands: CropHands, settings: CropSettings, draws: Draws) -> DrawnHands:
    """Every crop's hand, seen along the rays through the middles of the pixels."""
    count, side = len(hands.points), settings.side_px
    points = _before_one_camera(hands, side)
    skin, last = last_labels(count, settings, draws)
    camera = assumed_camera(side, side, dtype=points.dtype).to(device=points.device)
    intrinsics = constant_tensor((_FOCAL * side, _FOCAL * side, 1.0), points.dtype, points.device).diag()
    camera = replace(camera, intrinsics=intrinsics)
    face, depth = rasterize_many(_without_arms(points, hands, last), hands.faces, camera, is_closed=True)
    is_seen = face >= 0
    pixel = is_seen.view(-1).nonzero()[:, 0]
    seen = face.view(-1).index_select(0, pixel)
    crop = torch.repeat_interleave(is_seen.flatten(1).sum(1))
    brightness = _light(hands, draws).view(-1).index_select(0, crop * len(hands.faces) + seen)
    is_covered = hands.labels.index_select(0, seen) > skin.index_select(0, crop)
    own = torch.cat(_colours(hands, draws)).index_select(0, crop + count * is_covered)
    return DrawnHands(
        is_hand=is_seen & (face < hands.hand_faces),
        depth=depth.masked_fill_(~is_seen, 0.0),
        pixel=pixel,
        colour=own * brightness[:, None],
    )


def _before_one_camera(hands: CropHands, side: int) -> Float[Tensor, "crops points 3"]:
    """The points moved within planes of equal depth, so that one camera with its principal point at (0, 0) shows each
    hand where its own does."""
    x, y, z = hands.points.unbind(-1)
    focal, (u, v) = hands.focal[:, None], hands.centre[:, :, None].unbind(1)
    return torch.stack((focal * x + u * z, focal * y + v * z, _FOCAL * side * z), -1) / (_FOCAL * side)


def _without_arms(points: Tensor, hands: CropHands, last: Int[Tensor, "crops"]) -> Float[Tensor, "crops points 3"]:
    """The forearms that are not there shrunk to a point."""
    first = hands.arm
    arms = torch.where((last == HAND)[:, None, None], points[:, first:].mean(1, keepdim=True), points[:, first:])
    return torch.cat((points[:, :first], arms), 1)


def _light(hands: CropHands, draws: Draws) -> Float[Tensor, "crops faces"]:
    """Brightness of every face: ambient and diffuse light, with normals that are means over neighbours."""
    count, views = len(hands.points), len(hands.points) // len(hands.normals)
    towards = draws.normal(count, 3) * constant_tensor(_LIGHT_SPREAD, torch.float32, draws.device)
    towards = torch.nn.functional.normalize(towards + constant_tensor(_LIGHT_FROM, torch.float32, draws.device), dim=-1)
    in_hand = (towards[:, None] @ hands.rotation).unflatten(0, (-1, views))[:, :, 0]
    diffuse = (in_hand @ hands.normals.mT).flatten(0, 1).clamp_min_(0)
    ambient = 0.25 + 0.5 * draws.uniform(count, 1)
    strength = 0.6 + 0.6 * draws.uniform(count, 1)
    return diffuse.mul_(strength * (1 - ambient)).add_(strength * ambient)


def _colours(hands: CropHands, draws: Draws) -> tuple[Float[Tensor, "crops 3"], Float[Tensor, "crops 3"]]:
    """RGB of each crop's skin, between two of the tones and the same in all views of a hand, and of its sleeve."""
    tones = 255 * constant_tensor(tuple(map(tuple, SKIN_TONES.values())), torch.float32, draws.device)
    people = len(hands.normals)
    which = draws.uniform(people) * (len(tones) - 1)
    below = which.long().clamp_max(len(tones) - 2)
    skin = torch.lerp(tones[below], tones[below + 1], (which - below)[:, None])
    skin = skin * (1 + 0.06 * draws.normal(people, 3))
    sleeve = 255 * draws.uniform(people, 3)
    return skin[hands.person], sleeve[hands.person]
