"""From evidence to probabilities, by logistic models fitted where the truth is known.

The models stand in quality.json, with the command that fitted them on simulated hands (`torchhand measure_quality`) and
how well they tell right fingers from wrong ones there.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.devices import kept
from torchhand.track.quality.evidence import EVIDENCE

Method = Literal["contour", "distance", "rig", "single"]
"""How estimates are made: by the contour or the distance-map update, of several cameras, or of single pictures."""

TIP_M = 0.02
"""Distance within which a fingertip is right, metres."""
HAND_EVIDENCE = (
    "all_fingers",
    "worst_finger",
    "overlap",
    "unexplained",
    "direction",
    "no_learned",
    "points",
    "no_points",
)
"""Columns of the evidence for a whole hand: logarithm of the product of its fingers' qualities and of the least of
them, and the columns of EVIDENCE that are the hand's, points as their mean over the fingers."""

_TABLE = Path(__file__).with_name("quality.json")
_LEAST = 1e-6


@dataclass(frozen=True, kw_only=True)
class LogisticModel:
    """Probability 1 / (1 + exp(-(bias + weights · x))) of evidence x."""

    bias: float
    weights: Float[Tensor, "evidence"]

    def __call__(self, evidence: Float[Tensor, "*batch evidence"]) -> Float[Tensor, "*batch"]:
        return torch.sigmoid(self.bias + evidence @ self.weights.to(evidence))

    @classmethod
    def of_json(cls, content: dict[str, Any], names: tuple[str, ...]) -> "LogisticModel":
        """Raises ValueError where the weights are of other evidence."""
        if tuple(content["weights"]) != names:
            raise ValueError(
                f"{_TABLE.name}: expected weights of {', '.join(names)}, got {', '.join(content['weights'])}"
            )
        return cls(bias=content["bias"], weights=torch.tensor(list(content["weights"].values()), dtype=torch.float64))


def hand_evidence(
    evidence: Float[Tensor, "*batch 5 evidence"], fingers: Float[Tensor, "*batch 5"]
) -> Float[Tensor, "*batch hand_evidence"]:
    """Evidence for a whole hand in the columns of HAND_EVIDENCE. fingers: their qualities."""
    told = fingers.clamp_min(_LEAST).log()
    mean = {name: evidence[..., EVIDENCE.index(name)].mean(-1) for name in HAND_EVIDENCE[2:]}
    return torch.stack((told.sum(-1), told.amin(-1), *mean.values()), -1)


def qualities(evidence: Float[Tensor, "5 evidence"], method: Method) -> tuple[float, Float[Tensor, "5"]]:
    """Quality of a hand and of its fingers.

    Of a finger: the probability that its tip lies within TIP_M of where it is, once the two hands are laid over one
    another rigidly. Of the hand: that no fingertip is farther than TIP_M from where it is in the picture (in space, for
    several cameras).
    """
    finger, hand = _models(method)
    fingers = finger(evidence)
    return float(hand(hand_evidence(evidence, fingers))), fingers


@kept(4)
def _models(method: Method) -> tuple[LogisticModel, LogisticModel]:
    table = json.loads(_TABLE.read_text(encoding="utf-8"))[method]
    return (
        LogisticModel.of_json(table["finger"], EVIDENCE),
        LogisticModel.of_json(table["hand"], HAND_EVIDENCE),
    )
