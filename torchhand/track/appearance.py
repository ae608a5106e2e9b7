"""What the hand looks like in this video: colours learned from one frame, the planes that edges are searched in, and
the parts of pictures in which silhouettes are compared."""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from torchhand.image import ColourModel, foreground_probability, learn_colours, relearn_colours

_FEWEST_PX = 50


@dataclass(frozen=True, kw_only=True)
class Agreement:
    """How a model's silhouette and the picture's compare."""

    overlap: float
    """Intersection over union, forearm cut at the wrist."""
    unexplained: float
    """Area of the picture's hand outside the model, in pieces as thick as a finger, in squares of the hand's length."""


@dataclass(frozen=True, kw_only=True)
class Appearance:
    """Colours of the hand (and a bare forearm) against those of the rest."""

    colours: ColourModel

    def probability(self, image: UInt8[Tensor, "height width 3"]) -> Float[Tensor, "height width"]:
        """Probability that a pixel shows the hand, lightly smoothed."""
        return _smoothed(foreground_probability(image, self.colours))


def _smoothed(plane: Float[Tensor, "height width"]) -> Float[Tensor, "height width"]:
    return torch.from_numpy(cv2.GaussianBlur(plane.numpy(), (3, 3), 0))


def grey(image: UInt8[Tensor, "height width 3"]) -> Float[Tensor, "height width"]:
    """Luminance, 0..1."""
    return torch.from_numpy(cv2.cvtColor(image.numpy(), cv2.COLOR_RGB2GRAY).astype(np.float32) * np.float32(1 / 255))


def mask_plane(mask: Bool[Tensor, "height width"]) -> Float[Tensor, "height width"]:
    """A mask as a picture to search edges in."""
    return torch.from_numpy(cv2.GaussianBlur(mask.numpy().astype(np.float32), (0, 0), 1.0))


def learn_appearance(
    image: UInt8[Tensor, "height width 3"],
    hand: Bool[Tensor, "height width"],
    other: Bool[Tensor, "height width"],
    margin_px: int,
) -> Appearance | None:
    """Colour model of `hand` against `other`, both shrunk by a margin; None where one of them is nearly empty."""
    sets = _without_margin(hand, other, margin_px)
    return None if sets is None else Appearance(colours=learn_colours(image, *sets))


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
    return (
        appearance if sets is None else Appearance(colours=relearn_colours(appearance.colours, image, *sets, keep=keep))
    )


def _without_margin(hand: Tensor, other: Tensor, margin_px: int) -> tuple[Tensor, Tensor] | None:
    """Both masks shrunk; None where one of them is nearly empty."""
    size = 2 * max(1, margin_px) + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    shrunk = [torch.from_numpy(cv2.erode(mask.numpy().astype(np.uint8), kernel) > 0) for mask in (hand, other)]
    return None if min(int(mask.sum()) for mask in shrunk) < _FEWEST_PX else (shrunk[0], shrunk[1])


def disc(shape: tuple[int, int], centre_px: Float[Tensor, "2"], radius_px: float) -> Bool[Tensor, "height width"]:
    """Pixels within a radius of a point."""
    x = torch.arange(shape[1], dtype=centre_px.dtype) - centre_px[0]
    y = torch.arange(shape[0], dtype=centre_px.dtype)[:, None] - centre_px[1]
    return x * x + y * y < radius_px**2


def touching(mask: Bool[Tensor, "height width"], other: Bool[Tensor, "height width"]) -> Bool[Tensor, "height width"]:
    """The connected pieces (8 neighbours) of a mask that share a pixel with another mask."""
    _, labels = cv2.connectedComponents(mask.numpy().view(np.uint8), connectivity=8)
    labels = np.asarray(labels, np.int32)
    keeps = np.bincount(labels[other.numpy()], minlength=int(labels.max()) + 1) > 0
    keeps[0] = False  # what is not in the mask
    return torch.from_numpy(keeps[labels])


def unexplained_px(
    model: Bool[Tensor, "height width"],
    picture: Bool[Tensor, "height width"],
    region: Bool[Tensor, "height width"],
    radius_px: float,
) -> int:
    """Pixels of the picture's hand outside the model, in pieces that a disc fits into: a finger that is not covered."""
    size = 2 * max(1, round(radius_px)) + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    rest = (picture & region & ~model).numpy().astype(np.uint8)
    return int(cv2.morphologyEx(rest, cv2.MORPH_OPEN, kernel).sum())
