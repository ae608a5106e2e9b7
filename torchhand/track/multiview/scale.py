"""The unit of a rig whose scale nobody knows, from the hand that its cameras see."""

import math
from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.fit.keypoints import triangulated
from torchhand.geometry import Camera, Rig, rig_size
from torchhand.hand import DOFS, HandKinematics, HandPose, ShapeSpace
from torchhand.track.multiview.hulls import Hulls
from torchhand.track.multiview.settings import HullOctreeSettings
from torchhand.track.scene import Masks, View

_BALL = 0.030
"""Radius, metres, of the largest ball in the hull of a fist or a relaxed hand."""
_SCALES = (0.6, 0.72, 0.86, 1.0, 1.17, 1.35, 1.6)
"""Factors that are tried about the unit that makes the largest ball so large: in a hand that stays flat it is half of
that, in an arm that is bare to the elbow half as large again."""
_DECISIVE = (0.2, 0.45, 0.7)  # quantiles of the balls of all frames: the frames at these decide about the size
_LEAF = 0.012  # metres of that carving, in which the ball is looked for; how large it is tells a finer one about it
_FIRST_SIZE = 0.6  # metres between the cameras in the first carving, which only tells the ball
_PALM = ((0, 5), (0, 9), (0, 17), (5, 17))  # keypoints between which no joint bends


def rough_units(
    cameras: Sequence[Camera], frames: Sequence[tuple[int, Masks]]
) -> tuple[tuple[float, ...], list[tuple[int, Masks]]]:
    """Candidates for the metres of the cameras' unit by the thickness of what all silhouettes show, one of them good
    to a tenth or so, and frames that are likely to tell which: from open hands to fists.

    No candidates where no frame has a hull.
    """
    first = _FIRST_SIZE / rig_size(cameras)
    hulls = Hulls(Rig(cameras).scaled(first), HullOctreeSettings(start_leaf=_LEAF))
    balls: list[tuple[float, int]] = []
    for place, (_, masks) in enumerate(frames):
        target = hulls.anywhere(masks, min_volume=0.0).target
        if target is not None and len(target.depth):
            near = hulls.near(masks, target.inner[target.depth.argmax()].double()).target
            found = target if near is None or not len(near.depth) else near
            balls.append((float(found.depth.max()), place))
    if not balls:
        return (), []
    balls.sort()
    unit = first * _BALL / balls[-1][0]
    places = sorted({balls[int(quantile * len(balls))][1] for quantile in _DECISIVE})
    return tuple(unit * scale for scale in _SCALES), [frames[place] for place in places]


def unit_by_points(
    cameras: Sequence[Camera],
    frames: Sequence[Sequence[View]],
    kinematics: HandKinematics,
    shape: Float[Tensor, "shape"],
) -> float | None:
    """Metres of the cameras' unit by the hands that detectors see in two views or more: it makes palms as large as that
    of a shape, in the median over the frames. None where no two views agree on a hand.

    cameras: as the views' keypoints are theirs.
    """
    nothing = torch.full((21, 2), torch.nan, dtype=torch.float64)
    points = [
        torch.stack([nothing if view.keypoints is None else view.keypoints.points_px.to(nothing) for view in views])
        for views in zip(*frames, strict=True)
    ]
    found = triangulated([camera.to(device=nothing.device, dtype=nothing.dtype) for camera in cameras], points).points
    sizes = _palm_sizes(found)
    size = float(sizes.nanmedian())
    if not math.isfinite(size) or size <= 0:
        return None
    known = kinematics(shape.new_zeros(len(DOFS)), shape).keypoints
    return float(_palm_sizes(known)) / size


def _palm_sizes(points: Float[Tensor, "*batch 21 3"]) -> Float[Tensor, "*batch"]:
    """Summed distances between points of the palm; NaN where one of them is missing."""
    first, second = zip(*_PALM, strict=True)
    return (points[..., list(first), :] - points[..., list(second), :]).norm(dim=-1).sum(-1)


def resized_shape(shape: Float[Tensor, "shape"], factor: float, space: ShapeSpace) -> Float[Tensor, "shape"]:
    """The hand when everything is so many times as large; held within the bounds."""
    metric = torch.tensor([unit == "m" for unit in space.units], device=shape.device)
    larger = torch.where(metric, factor * shape, shape)
    return larger.clamp(space.lower.to(shape), space.upper.to(shape))


def resized_pose(pose: HandPose, factor: float) -> HandPose:
    """The hand's pose when everything is so many times as large."""
    return replace(pose, dofs=torch.cat((factor * pose.dofs[..., :3], pose.dofs[..., 3:]), -1))


def size_factor(shape: Float[Tensor, "shape"], known: Float[Tensor, "shape"], space: ShapeSpace) -> float:
    """How many times larger than `shape` the known hand is, by the geometric mean of length and breadth."""
    here, there = space.metric(shape), space.metric(known)
    ratios = [float(there[name] / here[name]) for name in ("hand_length", "hand_breadth")]
    return math.sqrt(ratios[0] * ratios[1])
