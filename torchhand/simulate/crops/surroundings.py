"""What is behind crops' hands, what stands before them, and what a camera makes of it."""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from kornia.filters import gaussian_blur2d
from torch import Tensor

from torchhand.devices import is_host
from torchhand.simulate.crops.draws import Draws
from torchhand.simulate.crops.settings import CropSettings
from torchhand.simulate.scene import BACKGROUNDS, BackgroundKind, background_picture

_KINDS_OF_EACH: dict[BackgroundKind, int] = {"clutter": 10, "wall": 4}  # pictures of a kind in the bank, 2 of others
_BANK_SCALE = 2  # side of a picture of the bank over that of a crop
_NOISE_BANK = 1 << 20  # numbers
_SHARP = 0.6  # px: softness of an occluder's edge
_BLUR_KERNEL = (17, 17)  # px: that of OpenCV for the widest blur


@dataclass(frozen=True, kw_only=True)
class Backgrounds:
    """Pictures from which crops' backgrounds are cut."""

    pictures: Float[Tensor, "pictures height width 3"]
    """RGB, 0 to 255."""

    @classmethod
    def made(cls, side_px: int, generator: torch.Generator) -> "Backgrounds":
        """Backgrounds of every kind of the simulator."""
        side = _BANK_SCALE * side_px
        kinds: list[BackgroundKind] = [kind for kind in BACKGROUNDS for _ in range(_KINDS_OF_EACH.get(kind, 2))]
        pictures = [background_picture(kind, side, side, generator) for kind in kinds]
        return cls(pictures=torch.stack(pictures).float())

    def cut(self, count: int, side_px: int, draws: Draws) -> Float[Tensor, "count side side 3"]:
        """Random squares, brighter or darker, in colours that are shifted."""
        pictures, height, width, _ = self.pictures.shape
        which, top, left = (draws.places(count, n) for n in (pictures, height - side_px + 1, width - side_px + 1))
        gain = 0.5 + draws.uniform(count, 1)
        gain = (gain * (1 + 0.15 * draws.normal(count, 3))).repeat(1, side_px).unflatten(-1, (-1, 3))
        cut = self.pictures.new_empty(count, side_px, side_px, 3)
        for index, (own, y, x) in enumerate(zip(which, top, left, strict=True)):
            torch.mul(self.pictures[own, y : y + side_px, x : x + side_px], gain[index], out=cut[index])
        return cut


def occluded(
    pictures: Float[Tensor, "count side side 3"], settings: CropSettings, draws: Draws
) -> tuple[Float[Tensor, "count side side 3"], Bool[Tensor, "count side side"]]:
    """The pictures with an ellipse, a box or a bar before some of them, and where that is."""
    count, side, _, _ = pictures.shape
    hidden = pictures.new_zeros(count, side, side, dtype=torch.bool)
    chosen = (draws.uniform(count) < settings.occluder).nonzero()[:, 0]
    if not len(chosen):
        return pictures, hidden
    some = len(chosen)
    uniform = draws.uniform(some, 6, 1, 1)
    steps = torch.arange(side, dtype=pictures.dtype, device=pictures.device)
    angle = 2 * torch.pi * uniform[:, 0]
    x, y = steps - side * uniform[:, 1], steps[:, None] - side * uniform[:, 2]
    along, across = x * angle.cos() + y * angle.sin(), y * angle.cos() - x * angle.sin()
    long, short = side * (0.1 + 0.6 * uniform[:, 3]), side * (0.03 + 0.15 * uniform[:, 4])
    round_one = ((along / long).square() + (across / short).square()).sqrt()
    square_one = torch.maximum((along / long).abs(), (across / short).abs())
    inside = 1 - torch.where(uniform[:, 5] < 0.5, round_one, square_one)
    share = (0.5 + inside * short / _SHARP).clamp(0, 1)
    colour = 255 * draws.uniform(some, 1, 1, 3)
    pictures[chosen] = torch.lerp(pictures[chosen], colour.expand(some, side, side, 3), share[..., None])
    hidden[chosen] = share > 0.5
    return pictures, hidden


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """What a camera makes of pictures: its lens blurs, its sensor adds noise and rounds."""

    noise: Float[Tensor, "numbers"]
    """Normal random numbers, of which every picture takes a stretch that begins anywhere."""

    @classmethod
    def made(cls, generator: torch.Generator) -> "Sensor":
        return cls(noise=torch.randn(_NOISE_BANK, generator=generator))

    def developed(
        self, pictures: Float[Tensor, "count side side 3"], settings: CropSettings, draws: Draws
    ) -> UInt8[Tensor, "count side side 3"]:
        """Blur of lens and motion, the sensor's noise, and rounding."""
        count, values = len(pictures), pictures[0].numel()
        blur = draws.between(settings.blur_px, count, 2)
        std = draws.between(settings.noise, count)
        begin = draws.places(count, len(self.noise) - values + 1)
        noise = (self.noise[first : first + values].view(pictures.shape[1:]) for first in begin)
        if not is_host(pictures.device):
            blurred = gaussian_blur2d(pictures.permute(0, 3, 1, 2), _BLUR_KERNEL, blur.flip(1), border_type="replicate")
            noisy = torch.addcmul(blurred.permute(0, 2, 3, 1), torch.stack(list(noise)), std[:, None, None, None])
            return noisy.round_().clamp_(0, 255).to(torch.uint8)
        done = np.empty(pictures.shape, np.uint8)
        looks = zip(pictures.numpy(), done, noise, blur.tolist(), std.tolist(), strict=True)
        for picture, out, own, (x, y), strength in looks:
            blurred = cv2.GaussianBlur(picture, (0, 0), sigmaX=x, sigmaY=y, borderType=cv2.BORDER_REPLICATE)
            cv2.addWeighted(blurred, 1, own.numpy(), strength, 0, dst=out, dtype=cv2.CV_8U)
        return torch.from_numpy(done)
