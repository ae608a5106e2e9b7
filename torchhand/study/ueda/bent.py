"""Figures 13 and 14 of Ueda et al. 2003: a finger bent at its knuckle, found again by torques, step by step."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchhand.fit.hull import HullTorqueFit, HullTorqueSettings, SkinPoints, fit_by_torques
from torchhand.geometry import Camera
from torchhand.hand import DOFS, Hand, HandKinematics, HandPose, PoseSpace
from torchhand.volume import CarvingSettings, Octree, RootCube, carve, hull_field

Measure = Callable[[HandPose], Float[Tensor, "steps"]]
"""Degrees by which a finger is bent, by the poses on the way."""

INDEX_KNUCKLE = "index_mcp_fe"
_PROXIMAL = (5, 6)  # keypoints at the ends of the index's proximal phalanx


@dataclass(frozen=True, kw_only=True)
class BentFinger:
    """Silhouettes of a hand whose index is bent, and where the fit starts: the same hand, not bent."""

    cameras: Sequence[Camera]
    masks: Sequence[Bool[Tensor, "_height _width"]]
    root: RootCube
    hand: Hand
    shape: Float[Tensor, "shape"]
    space: PoseSpace
    """Pose space of what moves: no DOF of the root, for the palm's place is known."""
    start: HandPose
    """Start with a zero rotation vector."""
    measure: Measure
    truth_deg: float
    straight_masks: Sequence[Bool[Tensor, "_height _width"]] | None = None
    """Silhouettes of the hand before its index was bent, where it is not the model itself: the pose is first fitted to
    them, so that what is evaluated is the change, and not that two hands call different angles straight."""


@dataclass(frozen=True, kw_only=True)
class Convergence:
    """One fit, at the start and after every iteration."""

    error_deg: tuple[float, ...]
    """Figure 13: error of the angle, |estimated - true|, degrees."""
    inside_fraction: tuple[float, ...]
    """Figure 14: fraction of the vertices in the voxel model, which is the BLACK and GRAY octants (section 3.2)."""
    within_fraction: tuple[float, ...]
    """Fraction of the vertices within the surface that the fit goes by, in the middle of the GRAY shell."""
    milliseconds: float
    """Time of carving and fit together."""


def converge(case: BentFinger, level: int, settings: HullTorqueSettings) -> Convergence:
    """Fit at one level of the octree. Every camera must see the hand where it is."""
    start = case.start
    if case.straight_masks is not None:
        start = _fitted(case, _carved(case, case.straight_masks, level), settings, start).pose
    begun = time.perf_counter()
    octree = _carved(case, case.masks, level)
    found = _fitted(case, octree, settings, start)
    seconds = time.perf_counter() - begun
    error = (case.measure(found.poses) - case.truth_deg).abs()
    with torch.inference_mode():
        outside, _ = hull_field(octree).sample(SkinPoints(case.hand, case.shape).vertices(found.poses))
    return Convergence(
        error_deg=tuple(error.tolist()),
        inside_fraction=tuple((outside <= 0).double().mean(-1).tolist()),
        within_fraction=tuple(found.inside_fraction.double().tolist()),
        milliseconds=1e3 * seconds,
    )


def _carved(case: BentFinger, masks: Sequence[Tensor], level: int) -> Octree:
    return carve(masks, case.cameras, case.root, CarvingSettings(level=level, min_views=len(case.cameras)))


def _fitted(case: BentFinger, octree: Octree, settings: HullTorqueSettings, start: HandPose) -> HullTorqueFit:
    field, space = hull_field(octree, surface="middle"), case.space.about(start.dofs)
    return fit_by_torques(field, SkinPoints(case.hand, case.shape), space, start, settings)


def knuckle_deg(poses: HandPose) -> Float[Tensor, "steps"]:
    """The index's flexion at the knuckle, degrees: the paper's angle where the hand is the model itself."""
    return poses.dofs[:, DOFS.index(INDEX_KNUCKLE)].rad2deg()


def phalanx_turn_deg(keypoints: Float[Tensor, "steps 21 3"]) -> Float[Tensor, "steps"]:
    """How far the index's proximal phalanx turned in space since the first row, degrees: any two hands agree on it."""
    first, last = _PROXIMAL
    bone = torch.nn.functional.normalize(keypoints[:, last] - keypoints[:, first], dim=-1)
    difference, total = (bone - bone[:1]).norm(dim=-1), (bone + bone[:1]).norm(dim=-1)
    return (2 * torch.atan2(difference, total)).rad2deg()


def turn_of(kinematics: HandKinematics, shape: Float[Tensor, "shape"]) -> Measure:
    """`phalanx_turn_deg` of poses of that hand."""

    def turn(poses: HandPose) -> Float[Tensor, "steps"]:
        like = kinematics.default_shape
        poses = poses.to(like)
        return phalanx_turn_deg(kinematics(poses.dofs, shape.to(like), root_reference=poses.reference).keypoints)

    return turn
