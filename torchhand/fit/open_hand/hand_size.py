"""Metric size of a hand fitted to one picture, which shows proportions only."""

from dataclasses import dataclass, replace
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.fit.detect import Fit
from torchhand.geometry import Camera
from torchhand.hand import HandKinematics, ShapeSpace

SizeSource = Literal["hand length", "camera and distance", "population"]

_RULER_STD = 0.001  # metres: a hand's length can be measured no better


@dataclass(frozen=True, kw_only=True)
class HandSize:
    """Length of a hand, and how it is known."""

    length: float
    """Hand length, metres."""
    std: float
    """Standard deviation of the hand length, metres."""
    source: SizeSource


def known_length(length: float) -> HandSize:
    """A hand that was measured with a ruler."""
    return HandSize(length=length, std=_RULER_STD, source="hand length")


def length_at_distance(fit: Fit, kinematics: HandKinematics, camera: Camera, distance: float) -> HandSize:
    """Hand length from the distance, metres, of the palm's middle from a calibrated camera; its own error is not
    counted.

    Raises ValueError for an orthographic camera, whose pictures do not change with distance.
    """
    if camera.kind != "pinhole":
        raise ValueError(f"camera: expected a pinhole camera, got an {camera.kind} one")
    points = kinematics(fit.pose, fit.shape, root_reference=fit.root_reference).keypoints
    depth = float(0.5 * (points[0, 2] + points[9, 2]))
    length = float(fit.shape[kinematics.shape_space.names.index("hand_length")]) * distance / depth
    return HandSize(length=length, std=length * float(fit.pose_std[2]) / depth, source="camera and distance")


def population_length(space: ShapeSpace) -> HandSize:
    """The mean person's, with the spread over people."""
    place = space.names.index("hand_length")
    return HandSize(length=float(space.default[place]), std=float(space.std[place]), source="population")


def sized(fit: Fit, space: ShapeSpace, size: HandSize) -> Fit:
    """The same picture of a hand of that length: metric parameters and the root's place scale, ratios stay.

    The breadth is held within its bounds, which only very large and very small hands meet.
    """
    length, breadth = (space.names.index(name) for name in ("hand_length", "hand_breadth"))
    factor = size.length / float(fit.shape[length])
    shape, std = fit.shape.clone(), fit.shape_std.clone()
    shape[length], std[length] = size.length, size.std
    shape[breadth] = (factor * shape[breadth]).clamp(space.lower[breadth], space.upper[breadth])
    std[breadth] = torch.hypot(factor * std[breadth], shape[breadth] * size.std / size.length)
    pose, pose_std = fit.pose.clone(), fit.pose_std.clone()
    pose[:3], pose_std[:3] = factor * pose[:3], factor * pose_std[:3]
    return replace(fit, shape=shape, shape_std=std, pose=pose, pose_std=_with_scale(pose, pose_std, size))


def _with_scale(pose: Float[Tensor, "36"], std: Float[Tensor, "36"], size: HandSize) -> Float[Tensor, "36"]:
    """Place is as uncertain as the size is."""
    place = torch.hypot(std[:3], pose[:3].abs() * size.std / size.length)
    return torch.cat((place, std[3:]))
