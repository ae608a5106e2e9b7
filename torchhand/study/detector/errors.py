"""Errors of a detector in one recording: where its points lie along the fingers, how they scatter, and its angles."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.files import load_hand_model
from torchhand.fit.keypoints import KeypointSettings, PostureKeypoints
from torchhand.study.detector.recordings import DetectedRecording

_PALM = (0, 9)  # wrist and middle knuckle, whose distance is a hand's size
_BEFORE = (9, 0, 1, 2, 3, 0, 5, 6, 7, 0, 9, 10, 11, 0, 13, 14, 15, 0, 17, 18, 19)
"""Keypoint from which the bone before each one comes; of the wrist, the middle knuckle, so that its bone points into
the forearm."""


@dataclass(frozen=True, kw_only=True)
class DetectorErrors:
    """Errors of one recording; those in pictures as they would be of a hand of our default size."""

    name: str
    frames: int
    across: Float[Tensor, "frames 21 2"]
    """Errors in the picture's plane at the hand, metres."""
    bones: Float[Tensor, "frames 21 2"]
    """Unit vectors in space along the bone that ends in each point, as they are seen in that plane."""
    angles: Float[Tensor, "frames 30"]
    """Errors of the angles that are read from the points in space, radians; NaN where these tell nothing."""

    @property
    def offset(self) -> Float[Tensor, "21"]:
        """How far each point lies beyond the true one along its bone, metres; least squares."""
        return (self.across * self.bones).sum((0, -1)) / self.bones.square().sum((0, -1)).clamp_min(1e-9)

    def variance(self, offset: Float[Tensor, "21"]) -> Float[Tensor, "21"]:
        """Mean square along each axis of what an offset leaves, m²."""
        return (self.across - offset[:, None] * self.bones).square().mean((0, -1))

    @property
    def angle_variance(self) -> Float[Tensor, "30"]:
        """Mean square error of every angle, radians²; NaN for angles that are never told."""
        return self.angles.square().nanmean(0)

    @property
    def angle_correlation(self) -> float:
        """Correlation of the angles' errors, each angle's mean removed, with those of the frame before; NaN where no
        two frames tell."""
        away = self.angles - self.angles.nanmean(0)
        before, after = away[:-1], away[1:]
        both = (before * after).isfinite()
        common = (before * after)[both].sum() / (0.5 * (before.square() + after.square()))[both].sum()
        return float(common)


def detector_errors(recording: DetectedRecording) -> DetectorErrors:
    """Errors of a recording's detections, which must be some."""
    hand = load_hand_model().kinematics(recording.side, dtype=torch.float64)
    rest = hand(hand.default_shape.new_zeros(36), hand.default_shape).keypoints
    truth, camera = recording.truth, recording.camera
    size = _palm(rest) / _palm(truth)
    plane = camera.plane_from_pixels(recording.points_px)
    depth = truth[..., 2:]
    across = (plane - truth[..., :2] / depth) * depth * size[:, None, None]
    bones = truth - truth[:, list(_BEFORE)]
    bones = bones / bones.norm(dim=-1, keepdim=True).clamp_min(1e-9)
    seen = bones[..., :2] - truth[..., :2] / depth * bones[..., 2:]  # along the line of sight nothing is seen
    read, true = (
        PostureKeypoints.of_points(points, hand, hand.default_shape, KeypointSettings())
        for points in (recording.points, truth)
    )
    told = (read.precision > 0) & (true.precision > 0)
    return DetectorErrors(
        name=recording.name,
        frames=len(recording),
        across=across,
        bones=seen,
        angles=torch.where(told, read.angles - true.angles, torch.nan),
    )


def _palm(points: Float[Tensor, "*frames 21 3"]) -> Float[Tensor, "*frames"]:
    return (points[..., _PALM[1], :] - points[..., _PALM[0], :]).norm(dim=-1)
