"""Logistic models of the evidence for fingers and hands, and how well they tell right from wrong."""

import itertools
from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchhand.evaluate import area_under_curve
from torchhand.study.quality.collect import FingerSample
from torchhand.track.quality import EVIDENCE, HAND_EVIDENCE, TIP_M, LogisticModel, hand_evidence

_RIDGE = 1.0  # of weights of standardized evidence: each is believed to be 0 ± 1
_STEPS = 50
_FOLDS = 5
_MIN_SAMPLES = 20  # fingers that are right, and that are wrong
_EDGES = (0.0, 0.1, 0.25, 0.5, 0.75, 0.9, 1.0)
"""Qualities between which their reliability is told."""


def calibrated(samples: Sequence[FingerSample]) -> dict[str, Any]:
    """Models of a finger and of a hand, for quality.json: bias, weights, and their figures on sequences that they were
    not fitted to. Raises ValueError where too few fingers are right or wrong."""
    if len(samples) < _MIN_SAMPLES:
        raise ValueError(f"samples: expected {_MIN_SAMPLES} or more, got {len(samples)}")
    evidence = torch.stack([one.evidence for one in samples])
    is_right = torch.stack([one.error_m for one in samples]) <= TIP_M
    is_hand_right = torch.tensor([one.farthest_m for one in samples]) <= TIP_M
    group = torch.tensor([one.sequence for one in samples])
    if min(int(is_right.sum()), int((~is_right).sum()), int((~is_hand_right).sum())) < _MIN_SAMPLES:
        raise ValueError(f"samples: expected {_MIN_SAMPLES} right and wrong fingers or more, got fewer")
    finger = fitted(evidence.flatten(0, 1), is_right.flatten())
    of_finger = group.repeat_interleave(is_right.shape[1])
    told = held_out(evidence.flatten(0, 1), is_right.flatten(), of_finger)
    whole = hand_evidence(evidence, told.unflatten(0, (len(samples), -1)))  # as fingers not fitted to have them
    hand = fitted(whole, is_hand_right)
    return {
        "finger": _described(finger, EVIDENCE) | figures(told, is_right.flatten()),
        "hand": _described(hand, HAND_EVIDENCE) | figures(held_out(whole, is_hand_right, group), is_hand_right),
    }


def fitted(evidence: Float[Tensor, "n evidence"], is_right: Bool[Tensor, "n"]) -> LogisticModel:
    """The likeliest logistic model, by Newton's method, with a normal prior of the weights of standardized evidence."""
    mean, std = evidence.mean(0), evidence.std(0)
    std = torch.where(std > 1e-9, std, 1.0)
    rows = torch.cat((torch.ones_like(evidence[:, :1]), (evidence - mean) / std), 1)
    prior = torch.full_like(rows[0], _RIDGE)
    prior[0] = 0
    weights = torch.zeros_like(rows[0])
    for _ in range(_STEPS):
        told = torch.sigmoid(rows @ weights)
        gradient = rows.mT @ (told - is_right.to(told)) + prior * weights
        matrix = rows.mT @ ((told * (1 - told))[:, None] * rows) + prior.diag()
        step = torch.linalg.solve(matrix, gradient)
        weights = weights - step
        if float(step.abs().max()) < 1e-9:
            break
    own = weights[1:] / std
    return LogisticModel(bias=float(weights[0] - own @ mean), weights=own)


def held_out(
    evidence: Float[Tensor, "n evidence"], is_right: Bool[Tensor, "n"], group: Int[Tensor, "n"]
) -> Float[Tensor, "n"]:
    """Probabilities by models that were fitted to other groups."""
    told = torch.full(is_right.shape, torch.nan, dtype=evidence.dtype)
    for fold in range(_FOLDS):
        own = group % _FOLDS == fold
        if bool(own.any()):
            told[own] = fitted(evidence[~own], is_right[~own])(evidence[own])
    return told


def figures(told: Float[Tensor, "n"], is_right: Bool[Tensor, "n"]) -> dict[str, Any]:
    """How well probabilities tell right from wrong: number, share that is right, area under the ROC curve, and for
    each interval of probabilities their mean, the share that is right, and the number."""
    intervals = {}
    for low, high in itertools.pairwise(_EDGES):
        inside = (told >= low) & ((told < high) | (high == 1.0))
        if bool(inside.any()):
            mean, share = float(told[inside].mean()), float(is_right[inside].double().mean())
            intervals[f"{low:g} to {high:g}"] = [round(mean, 3), round(share, 3), int(inside.sum())]
    return {
        "samples": len(told),
        "right": round(float(is_right.double().mean()), 3),
        "auc": round(area_under_curve(told, is_right), 3),
        "mean_right_number": intervals,
    }


def _described(model: LogisticModel, names: tuple[str, ...]) -> dict[str, Any]:
    weights = {name: round(value, 4) for name, value in zip(names, model.weights.tolist(), strict=True)}
    return {"bias": round(model.bias, 4), "weights": weights}
