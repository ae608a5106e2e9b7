"""What is believed of joint angles beside the silhouettes, as factors."""

from dataclasses import dataclass, field

from torchhand.fit import ConstraintPrior, Observation, PosturePrior, PostureResiduals
from torchhand.fit.hull.settings import JointPriorWeights
from torchhand.hand import PoseConstraints


@dataclass(frozen=True, kw_only=True)
class JointPriors:
    """Constraints between joint angles and likely postures, each where it is given and counts."""

    constraints: PoseConstraints | None = None
    postures: PostureResiduals | None = None
    weights: JointPriorWeights = field(default_factory=JointPriorWeights)

    @property
    def factors(self) -> tuple[Observation, ...]:
        """Priors for a problem. The postures, where they count, hold the ties between joints already."""
        w, found = self.weights, []
        has_postures = self.postures is not None and w.postures > 0
        if self.constraints is not None and w.constraints > 0:
            found.append(ConstraintPrior(constraints=self.constraints, weight=w.constraints, has_ties=not has_postures))
        if self.postures is not None and has_postures:
            found.append(PosturePrior(postures=self.postures, weight=w.postures, tail=w.posture_tail))
        return tuple(found)
