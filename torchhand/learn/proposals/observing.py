"""What a segmentation and a camera would make of rendered hands: views about them, ragged masks, grey levels."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor
from torch.nn import functional

from torchhand.learn.proposals.rendering import HAND, HAND_SHARE, RenderedHands
from torchhand.propose import SIDE_PX, SquareViews, gaussian_blur_of, network_channels, views_towards
from torchhand.simulate import FIRST_OF_FOREARM, LAST_OF_FOREARM

_WIDE = 0.4
_ROLL = math.radians(18)  # standard deviation of their turn
_NO_FOREARM, _NO_GREY = 0.3, 0.3  # shares
_SHIFT, _WIDE_SHIFT = 0.07, 0.3  # of the middle, over half the hand's size: standard deviation; largest
_SIZES, _WIDE_SIZES = (0.95, 1.35), (1.0, 1.7)  # of the square over the hand's
_STEEPNESS = 10.0  # of a mask's edge in its pixels


@dataclass(frozen=True, kw_only=True)
class SeenHands:
    """What the network sees of some hands, and the truth in the frames of the views."""

    channels: Float[Tensor, "hands channels side side"]
    rotation: Float[Tensor, "hands 3 3"]
    """view_from_hand"""
    joints: Float[Tensor, "hands 30"]
    place: Float[Tensor, "hands 2"]
    """Middle of the palm in the square, as in `ViewedHands`."""
    log_size: Float[Tensor, "hands"]


def seen_hands(hands: RenderedHands, generator: torch.Generator, *, wide: float = _WIDE) -> SeenHands:
    """Each hand in a random view, with the errors of a random segmentation under random lights.

    wide: share of the views that are about a whole silhouette, turned anyhow; the others hold the hand upright.
    """
    views = _views(hands, generator, wide)
    view_from_cam = views.cam_from_view.mT
    palm = (view_from_cam @ hands.palm[..., None]).squeeze(-1)
    grid = views.plane(SIDE_PX) / hands.reach[:, None, None, None]
    return SeenHands(
        channels=observed_channels(_visible(hands, generator), hands.depth, hands.normal, grid, generator),
        rotation=view_from_cam @ hands.rotation,
        joints=hands.joints,
        place=palm[:, :2] / palm[:, 2:] / views.reach[:, None],
        log_size=(hands.length / palm[:, 2] / views.reach).log(),
    )


def observed_channels(
    visible: Bool[Tensor, "n height width"],
    depth: UInt8[Tensor, "n height width"],
    normal: UInt8[Tensor, "n 2 height width"],
    grid: Float[Tensor, "n side side 2"],
    generator: torch.Generator,
    *,
    albedo: Float[Tensor, "n height width"] | None = None,
) -> Float[Tensor, "n channels side side"]:
    """What a network sees of rendered things through a random segmentation and under random lights.

    depth, normal: as in `RenderedHands`. grid: where each pixel of the view lies in the picture, -1 to 1. albedo:
    brightness under equal light; 1 all over if None.
    """
    grid = grid.clamp(-2, 2)
    silhouette = _sampled(visible[:, None].float(), grid)[:, 0]
    known = _known(len(visible), generator)
    mask = _ragged(silhouette, generator)
    grey = _shaded(depth, normal, grid, generator)
    if albedo is not None:
        grey = (grey * _sampled(albedo[:, None], grid)[:, 0]).clamp(0, 1)
    is_grey = _uniform(generator, len(visible), 1, 1) > _NO_GREY
    return network_channels(mask * known, torch.where(is_grey, grey, 0.5), known)


def _views(hands: RenderedHands, generator: torch.Generator, wide: float) -> SquareViews:
    count, half = len(hands), HAND_SHARE * hands.reach
    is_wide = _uniform(generator, count) < wide
    shift = torch.where(
        is_wide[:, None],
        _WIDE_SHIFT * (2 * _uniform(generator, count, 2) - 1),
        _SHIFT * torch.randn(count, 2, generator=generator),
    )
    fraction = _uniform(generator, count)
    sizes = [low + (high - low) * fraction for low, high in (_SIZES, _WIDE_SIZES)]
    roll = torch.where(
        is_wide,
        math.pi * (2 * _uniform(generator, count) - 1),
        _ROLL * torch.randn(count, generator=generator),
    )
    fingers = hands.rotation[:, :2, 1]
    x, y = fingers.unbind(-1)
    up = torch.stack((roll.cos() * x - roll.sin() * y, roll.sin() * x + roll.cos() * y, 0 * x), -1)
    centre = torch.cat((shift * half[:, None], torch.ones(count, 1)), -1)
    return views_towards(centre, up, half * torch.where(is_wide, sizes[1], sizes[0]))


def _visible(hands: RenderedHands, generator: torch.Generator) -> Bool[Tensor, "hands side side"]:
    """The hand, and the forearm up to a sleeve."""
    count = len(hands)
    end = FIRST_OF_FOREARM + (LAST_OF_FOREARM - FIRST_OF_FOREARM) * _uniform(generator, count, 1, 1)
    end = torch.where(_uniform(generator, count, 1, 1) < _NO_FOREARM, HAND, end)
    return (hands.label > 0) & (hands.label <= end)


def _ragged(mask: Float[Tensor, "n side side"], generator: torch.Generator) -> Float[Tensor, "n side side"]:
    """The mask with its edge moved, frayed, and with holes and further pieces as bad segmentations have them."""
    count = len(mask)
    soft = gaussian_blur_of(mask[:, None], 0.8)[:, 0]
    fraying = 0.14 * _uniform(generator, count, 1, 1) * _rarely(0.6, count, generator)
    level = 0.5 + 0.25 * (2 * _uniform(generator, count, 1, 1) - 1) * _rarely(0.6, count, generator)
    noise = _smooth_noise(count, 18, generator)
    ragged = torch.sigmoid(_STEEPNESS * (soft + fraying * noise * (soft > 0.02) - level))
    blobs = _smooth_noise(count, 7, generator)
    is_hole = blobs > 1.9 - 0.6 * _uniform(generator, count, 1, 1)
    is_piece = blobs < -2.1 + 0.5 * _uniform(generator, count, 1, 1)
    ragged = ragged * (1 - is_hole * _rarely(0.2, count, generator))
    return torch.maximum(ragged, is_piece * _rarely(0.12, count, generator))


def _known(count: int, generator: torch.Generator) -> Float[Tensor, "n side side"]:
    """1 inside the picture, whose edge may go through the view."""
    steps = (2 * torch.arange(SIDE_PX) + 1) / SIDE_PX - 1
    angle = 2 * math.pi * _uniform(generator, count, 1, 1)
    across = angle.cos() * steps + angle.sin() * steps[:, None]
    edge = torch.where(_uniform(generator, count, 1, 1) < 0.2, 0.3 + 0.9 * _uniform(generator, count, 1, 1), 9.0)
    return (across < edge).float()


def _shaded(
    depth: UInt8[Tensor, "n height width"],
    normal: UInt8[Tensor, "n 2 height width"],
    grid: Float[Tensor, "n side side 2"],
    generator: torch.Generator,
) -> Float[Tensor, "n side side"]:
    """Grey levels 0 to 1 under a random light: diffuse, darker in creases and along edges in depth, with noise."""
    count = len(depth)
    stored = torch.cat((depth[:, None], normal), 1).float() / 127.5 - 1
    depth, x, y = _sampled(stored, grid).unbind(1)
    z = -(1 - x.square() - y.square()).clamp_min(0).sqrt()
    light = torch.randn(count, 3, 1, 1, generator=generator) * torch.tensor((0.7, 0.7, 0.3))[:, None, None]
    light = functional.normalize(light + torch.tensor((0.0, -0.3, -1.0))[:, None, None], dim=1)
    diffuse = (light[:, 0] * x + light[:, 1] * y + light[:, 2] * z).clamp_min(0)
    ambient = 0.2 + 0.6 * _uniform(generator, count, 1, 1)
    hidden = (depth - gaussian_blur_of(depth[:, None], 1.5)[:, 0]).clamp(0, 0.2) / 0.2
    crease = (depth - gaussian_blur_of(depth[:, None].clamp_max(0.6), 0.8)[:, 0]).abs().clamp(0, 0.1) / 0.1
    grey = ambient + (1 - ambient) * diffuse
    grey = (
        grey * (1 - _uniform(generator, count, 1, 1) * hidden) * (1 - 0.7 * _uniform(generator, count, 1, 1) * crease)
    )
    grey = grey * (1 + 0.15 * _uniform(generator, count, 1, 1) * _smooth_noise(count, 6, generator))
    grey = grey + 0.05 * _uniform(generator, count, 1, 1) * torch.randn(grey.shape, generator=generator)
    grey = grey + 0.08 * _uniform(generator, count, 1, 1) * _smooth_noise(count, 24, generator)
    return (0.75 * grey).clamp(0, 1)


def _sampled(pictures: Float[Tensor, "n c h w"], grid: Float[Tensor, "n side side 2"]) -> Tensor:
    return functional.grid_sample(pictures, grid, mode="bilinear", padding_mode="border", align_corners=False)


def _smooth_noise(count: int, cells: int, generator: torch.Generator) -> Float[Tensor, "n side side"]:
    coarse = torch.randn(count, 1, cells, cells, generator=generator)
    return functional.interpolate(coarse, size=(SIDE_PX, SIDE_PX), mode="bilinear", align_corners=False)[:, 0] * 1.5


def _rarely(share: float, count: int, generator: torch.Generator) -> Float[Tensor, "n 1 1"]:
    return (_uniform(generator, count, 1, 1) < share).float()


def _uniform(generator: torch.Generator, *size: int) -> Tensor:
    return torch.rand(*size, generator=generator)
