"""The unit of a rig whose scale nobody knows, from the hand that its cameras see."""

import math
from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.geometry import Camera
from torchhand.geometry.rig import rig_size
from torchhand.hand import ShapeSpace
from torchhand.track.multiview.hulls import Hulls
from torchhand.track.multiview.settings import HullOctreeSettings
from torchhand.track.multiview.silhouettes import Masks
from torchhand.track.multiview.tracker import Anchor

_BALL = 0.028
"""Metres: radius of the largest ball in the hull of a hand, between half the thickness of a palm and half its breadth;
the fewer the cameras, the nearer to the latter."""
_FIRST_SIZE = 0.6  # metres between the cameras in the first carving, which only tells the ball


def in_unit(cameras: Sequence[Camera], metres: float) -> list[Camera]:
    """The same cameras when one unit of their translations is so many metres."""
    return [replace(camera, translation=metres * camera.translation) for camera in cameras]


def rough_unit(cameras: Sequence[Camera], moments: Sequence[tuple[int, Masks]]) -> float | None:
    """Metres of the cameras' unit, to within a quarter or so, by the thickness of what all silhouettes show.

    None where no moment has a hull.
    """
    first = _FIRST_SIZE / rig_size(cameras)
    hulls = Hulls(in_unit(cameras, first), HullOctreeSettings(start_leaf=0.006))
    depths = []
    for _, masks in moments:
        hull = hulls.anywhere(masks, least_volume=0.0)
        if hull.target is not None and len(hull.target.depth):
            depths.append(float(hull.target.depth.max()))
    if not depths:
        return None
    return first * _BALL / float(torch.tensor(depths).median())


def resized_shape(shape: Float[Tensor, "shape"], factor: float, space: ShapeSpace) -> Float[Tensor, "shape"]:
    """The hand when everything is so many times as large; held within the bounds."""
    metric = torch.tensor([unit == "m" for unit in space.units])
    larger = torch.where(metric, factor * shape, shape)
    return larger.clamp(space.lower.to(shape), space.upper.to(shape))


def moved_anchor(anchor: Anchor, factor: float) -> Anchor:
    """The same place when everything is so many times as large."""
    pose = anchor.pose.clone()
    pose[:3] = factor * pose[:3]
    return replace(anchor, pose=pose)


def size_factor(shape: Float[Tensor, "shape"], known: Float[Tensor, "shape"], space: ShapeSpace) -> float:
    """How many times larger than `shape` the known hand is, by the geometric mean of length and breadth."""
    here, there = space.metric(shape), space.metric(known)
    ratios = [float(there[name] / here[name]) for name in ("hand_length", "hand_breadth")]
    return math.sqrt(ratios[0] * ratios[1])
