"""What detected points in space tell of the hand, whatever their frame and size: its joint angles, each with an error.

A detector's points in space (such as MediaPipe's world landmarks) have an origin, a size and bones of their own, and
their errors go on from one end of a finger to the other. Angles between bones are free of all of that, so the points
are read as a posture once, and hands are compared with the posture.
"""

import json
import math
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.devices import constant_tensor, kept, read_back
from torchhand.fit import Equations, Explained, PosedHands, Stage
from torchhand.fit.keypoints.points import KeypointSettings
from torchhand.fit.keypoints.prior import missing_fraction, natural_posture
from torchhand.fit.keypoints.start import palm_weight, start_in_space
from torchhand.hand import FINGERS, JOINT_DOFS, HandKinematics, HandPose

POSTURE = "posture of keypoints"
_MIN_POINTS = 5  # points that tell how the hand is turned and still something of its fingers
_FREEDOM = 4.0  # degrees of freedom of the t distribution of a finger's errors
_PER_FINGER = len(JOINT_DOFS) // len(FINGERS)

_ERRORS = json.loads(Path(__file__).with_name("detector_errors.json").read_text(encoding="utf-8"))

# Standard deviations of the angles of MediaPipe's world landmarks, read as here, by DOF (`torchhand measure_detector`).
# Others are not read.
_STD: dict[str, float] = {name: entry["std_rad"] for name, entry in _ERRORS["angles"].items()}
_STD_RAD = tuple(_STD.get(dof, math.inf) for dof in JOINT_DOFS)
_LASTING: float = _ERRORS["angle_correlation"]  # correlation of an error with that of the frame before
_ADDED_UP = 5  # frames that a filter adds up before it forgets: some 0.15 s, as long as its motion model foretells
_REPEATED = 1 + 2 * sum((1 - lag / _ADDED_UP) * _LASTING**lag for lag in range(1, _ADDED_UP))
"""Variance of the mean of so many successive readings over that of as many independent ones."""


@dataclass(frozen=True, kw_only=True)
class PostureKeypoints:
    """Joint angles as points in space have them; one hand for all hypotheses, or a row for each frame."""

    pose: HandPose
    """(#rows), the points' hand in the world: angles within the limits, rotation if the points' axes are the camera's;
    its place says nothing."""
    precision: Float[Tensor, "#rows 30"]
    """Inverse variances of the angles, radians⁻²; 0 where points are missing or tell nothing."""
    view: int = 0

    @classmethod
    def of_points(
        cls,
        points: Float[Tensor, "#rows 21 3"],
        kinematics: HandKinematics,
        shape: Float[Tensor, "shape"],
        settings: KeypointSettings,
        *,
        world_from_points: Float[Tensor, "3 3"] | None = None,
        view: int = 0,
    ) -> "PostureKeypoints":
        """points: any frame and unit; NaN for missing ones. world_from_points: where their axes are known; they are
        the world's where it is None."""
        is_known = points.isfinite().all(-1)
        is_known &= is_known.sum(-1, keepdim=True) >= _MIN_POINTS
        natural = natural_posture(dtype=points.dtype, device=points.device).mean
        rest = _natural_keypoints(kinematics) if shape is kinematics.default_shape else None
        pose, _ = start_in_space(kinematics, points.nan_to_num(), is_known, shape, natural, rest=rest)
        if world_from_points is not None:
            pose = replace(pose, reference=world_from_points.to(points) @ pose.reference)
        std = settings.angle_error * constant_tensor(_STD_RAD, points.dtype, points.device)
        is_placed = (palm_weight(is_known) > 0.5).sum(-1, keepdim=True) >= 3
        told = (missing_fraction(is_known.to(points))[:, -len(JOINT_DOFS) :] < 0.5) & is_placed
        return cls(pose=pose, precision=torch.where(told, std.square().reciprocal(), 0.0), view=view)

    @property
    def is_empty(self) -> bool:
        return self._is_empty

    @cached_property
    def _is_empty(self) -> bool:
        return not read_back(self.precision > 0).any()

    @property
    def angles(self) -> Float[Tensor, "#rows 30"]:
        """Radians, in the order of JOINT_DOFS."""
        return self.pose.dofs[:, -len(JOINT_DOFS) :]

    def rows(self, rows: "Int[Tensor, 'n'] | slice") -> "PostureKeypoints":
        """Of some of the frames; itself where the points are the same for all."""
        if len(self.pose) == 1:
            return self
        return replace(self, pose=self.pose[rows], precision=self.precision[rows])

    def deviation(self, joints: Float[Tensor, "k 30"]) -> Float[Tensor, "k 5"]:
        """Root mean square difference of each finger's angles, in standard deviations; NaN where nothing is known."""
        precision = self.precision.to(joints).expand(len(joints), -1)
        missed = _by_finger(precision * (joints - self.angles.to(joints)).square())
        return (missed / _by_finger(precision > 0)).sqrt()

    def associate(self, hands: PosedHands, stage: Stage) -> "PostureKeypointFactor":
        """What each finger counts: less, the farther it is from the hand's (Student's t)."""
        joints = hands.pose.dofs[:, -len(JOINT_DOFS) :]
        precision = self.precision.to(joints).expand(len(joints), -1)
        count = _by_finger(precision > 0)
        missed = count * self.deviation(joints).square().nan_to_num()
        trust = (_FREEDOM + count) / (_FREEDOM + missed)
        cost = 0.5 * ((_FREEDOM + count) * (missed / _FREEDOM).log1p() - trust * missed)
        return PostureKeypointFactor(
            angles=self.angles.to(joints).expand(len(joints), -1),
            precision=precision,
            trust=trust.repeat_interleave(_PER_FINGER, -1),
            floor=cost.sum(-1),
            fraction=(missed <= 2 * count).to(joints).mean(-1),
            view=self.view,
        )


@dataclass(frozen=True, kw_only=True)
class PostureKeypointFactor:
    """½ Σ trust · precision · (angle - detected angle)² above a floor, which makes it the logarithm of the t
    distribution at the association; a row per hand."""

    angles: Float[Tensor, "k 30"]
    precision: Float[Tensor, "k 30"]
    """0 where nothing is known."""
    trust: Float[Tensor, "k 30"]
    """What each angle counts: more than 1 near the hand."""
    floor: Float[Tensor, "k"]
    fraction: Float[Tensor, "k"]
    view: int

    def equations(self, hands: PosedHands) -> Equations:
        """In the joint angles."""
        missed = hands.pose.dofs[:, -len(JOINT_DOFS) :] - self.angles
        weight = self.trust * self.precision
        pull = weight * missed
        return Equations(
            cost=self.floor + 0.5 * (pull * missed).sum(-1),
            gradient=pull,
            matrix=weight.diag_embed(),
            first_dof=hands.pose.dofs.shape[-1] - len(JOINT_DOFS),
        )

    def predict(self, hands: PosedHands) -> Float[Tensor, "k m"]:
        """Joint angles of any number of hands, as `measurement` has them."""
        return hands.pose.dofs[:, -len(JOINT_DOFS) :]

    def measurement(self) -> tuple[Float[Tensor, "m"], Float[Tensor, "m"], Bool[Tensor, "m"]]:
        """Of the first row: values, variances, and which are known; for filters, which have a belief of their own to
        weigh a finger against: trust does not count. As errors last for frames, variances are larger by what
        these have in common."""
        precision = self.precision[0]
        is_known = precision > 0
        return self.angles[0], _REPEATED / torch.where(is_known, precision, 1.0), is_known

    def rows(self, rows: Int[Tensor, "n"]) -> "PostureKeypointFactor":
        """Of some of the hands."""
        own = {name: getattr(self, name)[rows] for name in ("angles", "precision", "trust", "floor", "fraction")}
        return replace(self, **own)

    def explained(self) -> tuple[Explained, ...]:
        """Share of the fingers whose angles are those of the points within √2 standard deviations on average; their
        distance counts for nothing here."""
        return (
            Explained(name=POSTURE, view=self.view, fraction=self.fraction, distance=torch.zeros_like(self.fraction)),
        )


@kept(8)
def _natural_keypoints(kinematics: HandKinematics) -> Float[Tensor, "21 3"]:
    """Keypoints of the half-open hand of default proportions, which all pictures' points are first compared with."""
    like = kinematics.default_shape
    return kinematics(natural_posture(dtype=like.dtype, device=like.device).mean).keypoints


def _by_finger(values: Tensor) -> Tensor:
    """Sums (k, 5)."""
    return values.unflatten(-1, (-1, _PER_FINGER)).sum(-1)
