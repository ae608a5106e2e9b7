"""Labelled crops of hands, a batch at a time."""

from collections.abc import Iterator
from dataclasses import dataclass, fields

import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor

from torchhand.devices import HOST, sent_to
from torchhand.geometry import vector_from_rotation
from torchhand.hand import HandModel
from torchhand.simulate.crops.drawing import drawn_hands
from torchhand.simulate.crops.draws import Draws
from torchhand.simulate.crops.hands import CropHands, crop_hands
from torchhand.simulate.crops.settings import CropSettings
from torchhand.simulate.crops.surroundings import Backgrounds, Sensor, occluded

_DRAWN_AT_ONCE = 256  # postures and people


@dataclass(frozen=True, kw_only=True)
class Crops:
    """Pictures of hands with what is true of them, in the frames of the crops' own pinhole cameras."""

    image: UInt8[Tensor, "crops side side 3"]
    """RGB."""
    mask: Bool[Tensor, "crops side side"]
    """Pixels that show the hand, without its forearm and without what something else hides."""
    depth: Float[Tensor, "crops side side"]
    """Depth of hand and forearm as if nothing stood before them, metres; 0 beside."""
    keypoints: Float[Tensor, "crops 21 3"]
    """Keypoints in the camera frame, metres."""
    keypoints_px: Float[Tensor, "crops 21 2"]
    intrinsics: Float[Tensor, "crops 3 3"]
    pose: Float[Tensor, "crops 36"]
    """Metres and radians, in the order of DOFS; the root in the camera frame."""
    shape: Float[Tensor, "crops shape"]
    """Parameters of the shape space."""
    is_left: Bool[Tensor, "crops"]
    person: Int[Tensor, "crops"]
    """The same number in all crops of one hand at one time: their cameras saw it together."""

    def __len__(self) -> int:
        return len(self.person)

    def rows(self, rows: slice) -> "Crops":
        """Some of the crops."""
        return Crops(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})

    def tensors(self) -> dict[str, Tensor]:
        """The fields by name."""
        return {f.name: getattr(self, f.name) for f in fields(self)}


class CropMaker:
    """Makes batches of crops; computes with float32."""

    def __init__(
        self,
        model: HandModel,
        settings: CropSettings,
        generator: torch.Generator,
        device: torch.device = HOST,
    ) -> None:
        """generator: of the processor; draws the pictures that backgrounds are cut from. device: that crops are made
        on, and stay on: the same hands before the same things on any, pictures within a few grey levels."""
        self.settings, self._device = settings, device
        self._hand, self._prior = model.hand().to(device), model.prior()
        self._backgrounds = sent_to(Backgrounds.made(settings.side_px, generator), device)
        self._sensor = sent_to(Sensor.made(generator), device)

    def batches(self, people: int, generator: torch.Generator) -> Iterator[Crops]:
        """Crops of so many hands at a time without end, `settings.views` of each hand one after the other.

        The same seed gives the same batches.
        """
        pose, shape = self._prior.sample(0, generator)
        while True:
            if len(pose) < people:  # many are drawn together, which is faster
                more = self._prior.sample(max(people, _DRAWN_AT_ONCE), generator)
                pose, shape = (torch.cat(pair) for pair in zip((pose, shape), more, strict=True))
            yield self._crops((pose[:people], shape[:people]), Draws(generator=generator, device=self._device))
            pose, shape = pose[people:], shape[people:]

    @torch.no_grad()
    def _crops(self, people: tuple[Tensor, Tensor], draws: Draws) -> Crops:
        settings, (pose, shape) = self.settings, people
        hands = crop_hands(self._hand, (pose.to(draws.device), shape.to(draws.device)), settings, draws)
        drawn = drawn_hands(hands, settings, draws)
        picture = drawn.before(self._backgrounds.cut(len(hands.person), settings.side_px, draws))
        picture, hidden = occluded(picture, settings, draws)
        image = self._sensor.developed(picture, settings, draws)
        return _labelled(hands, image, drawn.is_hand & ~hidden, drawn.depth)


def _labelled(hands: CropHands, image: Tensor, mask: Tensor, depth: Tensor) -> Crops:
    """The crops, those of left hands mirrored: in the picture, and in their labels."""
    left, side = hands.is_left, image.shape[1]
    mirrored = left.nonzero()[:, 0]
    for pixels in (image, mask, depth):
        pixels[mirrored] = pixels[mirrored].flip(2)
    sign = torch.where(left, -1.0, 1.0)
    one = torch.ones_like(sign)
    keypoints = hands.keypoints * torch.stack((sign, one, one), -1)[:, None]
    rotation = (
        hands.rotation * torch.stack((sign, one, one), -1)[..., None] * torch.stack((one, one, sign), -1)[:, None]
    )
    centre = torch.where(
        left[:, None], torch.stack((side - 1 - hands.centre[:, 0], hands.centre[:, 1]), -1), hands.centre
    )
    intrinsics = torch.zeros(len(left), 3, 3, device=left.device)
    intrinsics[:, 0, 0] = intrinsics[:, 1, 1] = hands.focal
    intrinsics[:, :2, 2], intrinsics[:, 2, 2] = centre, 1
    # The wrist is the hand frame's origin.
    root = torch.cat((keypoints[:, 0], vector_from_rotation(rotation)), -1)
    return Crops(
        image=image,
        mask=mask,
        depth=depth,
        keypoints=keypoints,
        keypoints_px=hands.focal[:, None, None] * keypoints[..., :2] / keypoints[..., 2:] + centre[:, None],
        intrinsics=intrinsics,
        pose=torch.cat((root, hands.joints), -1),
        shape=hands.shape,
        is_left=left,
        person=hands.person,
    )
