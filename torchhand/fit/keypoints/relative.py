"""Keypoints in space of which neither place nor size is known, as an observation: MediaPipe's world landmarks."""

from dataclasses import dataclass, replace
from functools import cached_property

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.devices import read_back
from torchhand.fit import Equations, Explained, PosedHands, Stage
from torchhand.fit.keypoints.points import Detector, equations_of_points
from torchhand.geometry import Camera
from torchhand.hand import HandKinematics

STD_M = 0.008
"""Standard deviation of MediaPipe's world landmarks across the line of sight, metres, where all points of a hand
count."""
DEPTH_STD_M = 0.012
"""The same along the line of sight."""


@dataclass(frozen=True, kw_only=True)
class RelativeKeypoints:
    """Points in space about an origin and in a unit of their own, along the axes of a camera; one hand for all
    hypotheses, or a row for each frame.

    The hand's size over that of the points varies from frame to frame with such detectors (MediaPipe's by a third
    within one recording), and depth is what they tell worst.
    """

    points: Float[Tensor, "#rows 21 3"]
    """NaN for missing points."""
    kinematics: HandKinematics
    cam_from_world: Float[Tensor, "#rows 3 3"]
    """Rotation into the axes of the points."""
    std: Float[Tensor, "3"]
    """Standard deviation of a point along each of its axes, in the points' unit."""
    detector: Detector | None = None
    """Properties of the detector; None for one whose keypoints are ours."""

    @classmethod
    def of_points(
        cls, points: Float[Tensor, "#rows 21 3"], kinematics: HandKinematics, camera: Camera
    ) -> "RelativeKeypoints":
        """Points as MediaPipe's world landmarks: metres along the axes of a camera, or of one for each row."""
        std = points.new_tensor((STD_M, STD_M, DEPTH_STD_M))
        turn = camera.rotation.to(points).reshape(-1, 3, 3)
        return cls(points=points, kinematics=kinematics, cam_from_world=turn, std=std)

    @property
    def is_empty(self) -> bool:
        return self._is_empty

    @cached_property
    def _is_empty(self) -> bool:
        return not read_back(self.is_known).any()

    @property
    def is_known(self) -> Bool[Tensor, "#rows 21"]:
        """Points that are not missing."""
        return self.points.isfinite().all(-1)

    def rows(self, rows: "Int[Tensor, 'n'] | slice") -> "RelativeKeypoints":
        """The rows of some of the frames; itself where the points are the same for all."""
        if len(self.points) == 1:
            return self
        turn = self.cam_from_world
        return replace(self, points=self.points[rows], cam_from_world=turn if len(turn) == 1 else turn[rows])

    def associate(self, hands: PosedHands, stage: Stage) -> "RelativeKeypointFactor":
        """Every known point counts the same at any distance."""
        like, count, is_known = hands.pose.dofs, len(hands), self.is_known
        weight = is_known.to(like)[..., None]
        points = torch.where(is_known[..., None], self.points, 0.0).to(like)
        return RelativeKeypointFactor(
            kinematics=self.kinematics,
            points=(weight * (points - _mean(points, weight)) / self.std.to(like)).expand(count, -1, -1),
            weight=weight.expand(count, -1, -1),
            axes=(self.cam_from_world.to(like) / self.std.to(like)[:, None]).expand(count, -1, -1),
            detector=self.detector or Detector.known(like),
        )


@dataclass(frozen=True, kw_only=True)
class RelativeKeypointFactor:
    """½ Σ |scale · (keypoint - mean) - (point - mean)|² / std² at the scale that makes it smallest; a row per hand."""

    kinematics: HandKinematics
    points: Float[Tensor, "k 21 3"]
    """Points about their mean, in standard deviations; 0 for missing ones."""
    weight: Float[Tensor, "k 21 1"]
    """1 for known points, 0 for missing ones."""
    axes: Float[Tensor, "k 3 3"]
    """Axes of the points in the world, over the standard deviations along them."""
    detector: Detector

    def equations(self, hands: PosedHands) -> Equations:
        """Normal equations in the DOFs, and in the shared unknowns where there are some.

        The scale is the best one at every hand, so that the cost's derivative in it is zero: the gradient at a fixed
        scale is that of the cost (Golub and Pereyra 1973). What a scale would make good is no information, and is taken
        from the derivatives (Kaufman 1975).
        """
        keypoints = self._about_mean(self.detector.keypoints(self.kinematics, hands)[..., None])[..., 0]
        size = keypoints.square().sum((-2, -1)).clamp_min(torch.finfo(keypoints.dtype).tiny)
        scale = ((keypoints * self.points).sum((-2, -1)) / size)[:, None, None]
        along = keypoints / size.sqrt()[:, None, None]

        def scaled(jacobian: Float[Tensor, "k 21 3 c"]) -> Float[Tensor, "k 21 3 c"]:
            away = self._about_mean(jacobian)
            grown = (along[..., None] * away).sum((1, 2), keepdim=True)
            return scale[..., None] * (away - along[..., None] * grown)

        rows, shared = scaled(self.detector.pose_jacobian(self.kinematics, hands)), None
        if hands.unknowns is not None:
            shared = scaled(self.detector.shared_jacobian(self.kinematics, hands))
        return equations_of_points(scale * keypoints - self.points, self.weight[..., 0], None, rows, shared)

    def rows(self, rows: Int[Tensor, "n"]) -> "RelativeKeypointFactor":
        """The rows of some of the hands."""
        return replace(self, **{name: getattr(self, name)[rows] for name in ("points", "weight", "axes")})

    def explained(self) -> tuple[Explained, ...]:
        """Nothing: every point counts the same."""
        return ()

    def _about_mean(self, vectors: Float[Tensor, "k 21 3 c"]) -> Float[Tensor, "k 21 3 c"]:
        """Vectors of the known points, or their derivatives, about their mean along the points' axes."""
        weight = self.weight[..., None]
        away = weight * (vectors - _mean(vectors, weight))
        return self.axes[:, None] @ away


def _mean(values: Tensor, weight: Tensor) -> Tensor:
    """Mean over the points (second dimension), kept as a dimension."""
    return (weight * values).sum(1, keepdim=True) / weight.sum(1, keepdim=True).clamp_min(1.0)
