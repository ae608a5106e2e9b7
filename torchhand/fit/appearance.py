"""What the hand looks like in this video: colours learned from one frame, the planes that edges are searched in, and
the parts of pictures in which silhouettes are compared."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from torchhand.image import (
    ColourModel,
    Light,
    binomial_blur,
    disc_kernel,
    erode,
    foreground_probability,
    gaussian_blur,
    learn_colours,
    luminance,
    opened,
    relearn_colours,
    touching,
)

_MIN_PIXELS = 50


@dataclass(frozen=True, kw_only=True)
class Appearance:
    """Colours of the hand (and a bare forearm) against those of the rest."""

    colours: ColourModel
    light: Light
    """The light in which the colours are these, as it was when they were last learned."""

    def probability(self, image: UInt8[Tensor, "height width 3"]) -> Float[Tensor, "height width"]:
        """Probability that a pixel shows the hand, lightly smoothed."""
        return binomial_blur(foreground_probability(self.light.undone(image), self.colours))


def grey(image: UInt8[Tensor, "height width 3"]) -> Float[Tensor, "height width"]:
    """Luminance, 0..1, rounded to 1/255."""
    return luminance(image).float().mul_(1 / 255)


def mask_plane(mask: Bool[Tensor, "height width"]) -> Float[Tensor, "height width"]:
    """A mask as a picture to search edges in."""
    return gaussian_blur(mask.float(), 1.0)


def learn_appearance(
    image: UInt8[Tensor, "height width 3"],
    hand: Bool[Tensor, "height width"],
    other: Bool[Tensor, "height width"],
    margin_px: int,
) -> Appearance | None:
    """Colour model of `hand` against `other`, both shrunk by a margin; None where one of them is nearly empty."""
    sets = _without_margin(hand, other, margin_px)
    return None if sets is None else Appearance(colours=learn_colours(image, *sets), light=Light.of(image))


def relearned(
    appearance: Appearance,
    image: UInt8[Tensor, "height width 3"],
    probability: Float[Tensor, "height width"],
    model: Bool[Tensor, "height width"],
    margin_px: int,
    *,
    keep: float,
) -> Appearance:
    """The colours after some time of changing light; `keep` as for `relearn_colours`.

    model: silhouette of the hand as it is followed. What touches it and has the hand's colours, such as a forearm,
    counts neither as hand nor as surroundings. The appearance comes back as it is where there is too little to learn
    from.
    """
    sets = _without_margin(model, ~(model | touching(probability > 0.5, model)), margin_px)
    if sets is None:
        return appearance
    light = appearance.light
    colours = relearn_colours(appearance.colours, light.undone(image), *sets, keep=keep)
    return Appearance(colours=colours, light=light.later(image))


def _without_margin(hand: Tensor, other: Tensor, margin_px: int) -> tuple[Tensor, Tensor] | None:
    """Both masks shrunk; None where one of them is nearly empty."""
    shrunk = [erode(mask, disc_kernel(max(1, margin_px))) for mask in (hand, other)]
    return None if min(int(mask.sum()) for mask in shrunk) < _MIN_PIXELS else (shrunk[0], shrunk[1])


def disc(shape: tuple[int, int], centre_px: Float[Tensor, "2"], radius_px: float) -> Bool[Tensor, "height width"]:
    """Pixels within a radius of a point."""
    x = torch.arange(shape[1], dtype=centre_px.dtype) - centre_px[0]
    y = torch.arange(shape[0], dtype=centre_px.dtype)[:, None] - centre_px[1]
    return x * x + y * y < radius_px**2


def unexplained_px(
    model: Bool[Tensor, "height width"],
    picture: Bool[Tensor, "height width"],
    region: Bool[Tensor, "height width"],
    radius_px: float,
) -> int:
    """Pixels of the picture's hand outside the model, in pieces that a disc fits into: a finger that is not covered."""
    return int(opened(picture & region & ~model, disc_kernel(max(1, round(radius_px)))).sum())
