"""Keypoints in the world as an observation: points of known place, in metres or in a unit that is to be found."""

from dataclasses import dataclass, replace
from functools import cached_property

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.devices import read_back
from torchhand.fit import Equations, Explained, PosedHands, Stage
from torchhand.fit.keypoints.points import Detector, KeypointSettings, equations_of_points, trusted_fraction
from torchhand.hand import HandKinematics
from torchhand.numerics import RobustLoss

IN_WORLD = "keypoints in the world"


@dataclass(frozen=True, kw_only=True)
class WorldKeypoints:
    """Points in space whose place and direction are the hand's; one hand for all hypotheses, or a row for each
    frame."""

    points: Float[Tensor, "#rows 21 3"]
    """Points in the world, in the detector's unit; NaN for missing points."""
    kinematics: HandKinematics
    settings: KeypointSettings
    confidence: Float[Tensor, "#rows 21"] | None = None
    """Share of a point's information that is believed, 0 for missing points; all of it where None."""
    loss: RobustLoss | None = None
    """Loss of residuals in standard deviations, evaluated at every hand; None for what each point is trusted at the
    association."""
    detector: Detector | None = None
    """Properties of the detector; None for one that measures in metres and whose keypoints are ours."""

    @property
    def is_empty(self) -> bool:
        return self._is_empty

    @cached_property
    def _is_empty(self) -> bool:
        return not read_back(self.is_known).any()

    @property
    def is_known(self) -> Bool[Tensor, "#rows 21"]:
        """Points that are not missing."""
        is_known = self.points.isfinite().all(-1)
        return is_known if self.confidence is None else is_known & (self.confidence > 0)

    def rows(self, rows: "Int[Tensor, 'n'] | slice") -> "WorldKeypoints":
        """The rows of some of the frames; itself where the points are the same for all."""
        if len(self.points) == 1:
            return self
        confidence = None if self.confidence is None else self.confidence[rows]
        return replace(self, points=self.points[rows], confidence=confidence)

    def associate(self, hands: PosedHands, stage: Stage) -> "WorldKeypointFactor":
        """What each point counts: less, the farther it is from the hand."""
        s, like, is_known = self.settings, hands.pose.dofs, self.is_known
        weight = torch.where(is_known, 1.0 if self.confidence is None else self.confidence, 0.0).to(like)
        factor = WorldKeypointFactor(
            kinematics=self.kinematics,
            points=torch.where(is_known[..., None], self.points, 0.0).to(like).expand(len(hands), -1, -1),
            weight=(weight * s.space_std_m**-2).expand(len(hands), -1),
            trust=like.new_full((len(hands), weight.shape[1]), s.weight),
            loss=self.loss,
            detector=self.detector or Detector.known(like),
        )
        if self.loss is not None:
            return factor
        return replace(factor, trust=s.trust(factor.distance(hands), s.space_std_m, s.space_std_m, stage))


@dataclass(frozen=True, kw_only=True)
class WorldKeypointFactor:
    """½ Σ trust · |keypoint - scale · point|² / std², or a robust loss of that; a row per hand."""

    kinematics: HandKinematics
    points: Float[Tensor, "k 21 3"]
    weight: Float[Tensor, "k 21"]
    """Inverse variances, m⁻²; 0 for missing points."""
    trust: Float[Tensor, "k 21"]
    """Weight of each point, as a fraction of what it would if it were the only one and no outlier."""
    loss: RobustLoss | None
    detector: Detector

    def distance(self, hands: PosedHands) -> Float[Tensor, "k 21"]:
        """Distance of the hand's keypoints from the points, metres; 0 for missing ones."""
        return torch.where(self.weight > 0, self._missed(hands).norm(dim=-1), 0.0)

    def equations(self, hands: PosedHands) -> Equations:
        """Normal equations in the DOFs, and in the shared unknowns where there are some."""
        rows = self.detector.pose_jacobian(self.kinematics, hands)
        shared = None
        if hands.unknowns is not None:
            shared = self.detector.shared_jacobian(self.kinematics, hands)
            if self.detector.has_unknown_scale:
                shared[..., len(hands.unknowns.columns)] -= self._scale(hands) * self.points
        return equations_of_points(self._missed(hands), self.weight * self.trust, self.loss, rows, shared)

    def rows(self, rows: Int[Tensor, "n"]) -> "WorldKeypointFactor":
        """The rows of some of the hands."""
        return replace(self, points=self.points[rows], weight=self.weight[rows], trust=self.trust[rows])

    def explained(self) -> tuple[Explained, ...]:
        """Share of the points that are trusted by half at least; their distance counts for nothing here."""
        fraction = trusted_fraction(self.weight, self.trust)
        return (Explained(name=IN_WORLD, view=None, fraction=fraction, distance=torch.zeros_like(fraction)),)

    def _missed(self, hands: PosedHands) -> Float[Tensor, "k 21 3"]:
        return self.detector.keypoints(self.kinematics, hands) - self._scale(hands) * self.points

    def _scale(self, hands: PosedHands) -> Float[Tensor, ""]:
        return self.detector.at(hands.extra).log_scale.exp()
