"""What is behind crops' hands, what stands before them, and what a camera makes of it."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from torchhand.simulate.crops.settings import CropSettings
from torchhand.simulate.scene import BACKGROUNDS, BackgroundKind, background_picture

_KINDS_OF_EACH: dict[BackgroundKind, int] = {"clutter": 10, "wall": 4}  # pictures of a kind in the bank, 2 of others
_BANK_SCALE = 2  # side of a picture of the bank over that of a crop
_SHARP = 0.6  # px: softness of an occluder's edge


@dataclass(frozen=True, kw_only=True)
class Backgrounds:
    """Pictures from which crops' backgrounds are cut."""

    pictures: Float[Tensor, "pictures 3 height width"]
    """RGB, 0 to 255."""

    @classmethod
    def made(cls, side_px: int, generator: torch.Generator) -> "Backgrounds":
        """Backgrounds of every kind of the simulator."""
        side = _BANK_SCALE * side_px
        kinds: list[BackgroundKind] = [kind for kind in BACKGROUNDS for _ in range(_KINDS_OF_EACH.get(kind, 2))]
        pictures = [background_picture(kind, side, side, generator) for kind in kinds]
        return cls(pictures=torch.stack(pictures).movedim(-1, 1).float())

    def cut(self, count: int, side_px: int, generator: torch.Generator) -> Float[Tensor, "count 3 side side"]:
        """Random squares, brighter or darker, in colours that are shifted."""
        pictures, _, height, width = self.pictures.shape
        which = torch.randint(pictures, (count,), generator=generator).tolist()
        top = torch.randint(height - side_px + 1, (count,), generator=generator).tolist()
        left = torch.randint(width - side_px + 1, (count,), generator=generator).tolist()
        gain = 0.5 + torch.rand(count, 1, 1, 1, generator=generator)
        gain = gain * (1 + 0.15 * torch.randn(count, 3, 1, 1, generator=generator))
        cut = torch.empty(count, 3, side_px, side_px)
        for index, (own, y, x) in enumerate(zip(which, top, left, strict=True)):
            torch.mul(self.pictures[own, :, y : y + side_px, x : x + side_px], gain[index], out=cut[index])
        return cut


def occluded(
    pictures: Float[Tensor, "count 3 side side"], settings: CropSettings, generator: torch.Generator
) -> tuple[Float[Tensor, "count 3 side side"], Bool[Tensor, "count side side"]]:
    """The pictures with an ellipse, a box or a bar before some of them, and where that is."""
    count, _, side, _ = pictures.shape
    hidden = torch.zeros(count, side, side, dtype=torch.bool)
    chosen = (torch.rand(count, generator=generator) < settings.occluder).nonzero()[:, 0]
    if not len(chosen):
        return pictures, hidden
    some = len(chosen)
    uniform = torch.rand(some, 6, 1, 1, generator=generator)
    steps = torch.arange(side, dtype=pictures.dtype)
    angle = 2 * torch.pi * uniform[:, 0]
    x, y = steps - side * uniform[:, 1], steps[:, None] - side * uniform[:, 2]
    along, across = x * angle.cos() + y * angle.sin(), y * angle.cos() - x * angle.sin()
    long, short = side * (0.1 + 0.6 * uniform[:, 3]), side * (0.03 + 0.15 * uniform[:, 4])
    round_one = ((along / long).square() + (across / short).square()).sqrt()
    square_one = torch.maximum((along / long).abs(), (across / short).abs())
    inside = 1 - torch.where(uniform[:, 5] < 0.5, round_one, square_one)
    share = (0.5 + inside * short / _SHARP).clamp(0, 1)
    colour = 255 * torch.rand(some, 3, 1, 1, generator=generator)
    pictures[chosen] = torch.lerp(pictures[chosen], colour.expand(some, 3, side, side), share[:, None])
    hidden[chosen] = share > 0.5
    return pictures, hidden


def developed(
    pictures: Float[Tensor, "count 3 side side"], settings: CropSettings, generator: torch.Generator
) -> UInt8[Tensor, "count side side 3"]:
    """Blur of lens and motion, the sensor's noise, and rounding."""
    count, _, side, _ = pictures.shape
    low, high = settings.blur_px
    steps = torch.arange(side, dtype=pictures.dtype)
    squared = (steps - steps[:, None]).square()
    along_y, along_x = (
        torch.softmax(-0.5 * squared / (low + (high - low) * torch.rand(count, 1, 1, generator=generator)).square(), -1)
        for _ in range(2)
    )
    blurred = along_y[:, None] @ pictures @ along_x.mT[:, None]
    low, high = settings.noise
    std = low + (high - low) * torch.rand(count, 1, 1, 1, generator=generator)
    noisy = blurred + std * torch.randn(pictures.shape, generator=generator)
    return noisy.clamp_(0, 255).add_(0.5).to(torch.uint8).movedim(1, -1)
