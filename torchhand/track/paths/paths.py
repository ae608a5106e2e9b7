"""Which of several paths of a hand through a recording is believed, frame by frame (Rabiner 1989: forward-backward)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

MOTION_NATS = 100.0  # nats that a metre of motion costs from one frame to the next, in the mean over the keypoints
_TURN_NATS = 25.0
"""Nats that turning over costs from one frame to the next, besides. No hand does; a path that does has mistaken its
side, which the outline of a frame hardly tells, before or after."""


@dataclass(frozen=True, kw_only=True)
class HandPath:
    """One hand through all frames of a recording."""

    keypoints: Float[Tensor, "frames 21 3"]
    """Metres, world frame; NaN in frames without a hand."""
    evidence: Float[Tensor, "frames"]
    """How far the views bear the hand out, nats, comparable between the hands of one frame."""

    @property
    def has_hand(self) -> Bool[Tensor, "frames"]:
        return self.keypoints.isfinite().all(-1).all(-1)


def path_weights(paths: Sequence[HandPath]) -> Float[Tensor, "frames paths"]:
    """Probability that the hand is on each path, all frames considered; 0 where a path has no hand.

    A hidden Markov model: in every frame the hand is on one of the paths that have one, the evidence is what speaks for
    it, and a change costs the more, the farther the hand would have to move and to turn at once.
    """
    keypoints = torch.stack([path.keypoints for path in paths], 1)
    has_hand = torch.stack([path.has_hand for path in paths], 1)
    evidence = torch.stack([path.evidence for path in paths], 1).to(keypoints)
    if bool((has_hand & ~evidence.isfinite()).any()):
        raise ValueError("evidence: expected a finite number for every frame with a hand")
    is_empty = ~has_hand.any(1, keepdim=True)
    local = torch.where(has_hand, evidence, torch.where(is_empty, 0.0, -math.inf))
    moved = (keypoints[1:, None] - keypoints[:-1, :, None]).norm(dim=-1).mean(-1)  # (frames - 1, from, to)
    change = -(MOTION_NATS * moved + _TURN_NATS * _turned(keypoints)).nan_to_num(0.0)
    before, after = [local[:1]], [torch.zeros_like(local[:1])]
    for here, step in zip(local[1:, None], change, strict=True):
        before.append(here + (before[-1].mT + step).logsumexp(0, keepdim=True))
    for later, step in zip(local[1:].flip(0)[:, None], change.flip(0), strict=True):
        after.append((step + later + after[-1]).logsumexp(1)[None])
    total = torch.cat(before) + torch.cat(after[::-1])
    return torch.where(has_hand, total.softmax(1), 0.0)


def _turned(keypoints: Float[Tensor, "frames paths 21 3"]) -> Float[Tensor, "before paths paths"]:
    """From every path to every other in the next frame, 0 where the palm faces the same way, 1 where it turns over."""
    wrist, index, little = (keypoints[:, :, row] for row in (0, 5, 17))
    facing = torch.nn.functional.normalize(torch.linalg.cross(index - wrist, little - wrist), dim=-1)
    return 0.5 * (1 - (facing[1:, None] * facing[:-1, :, None]).sum(-1))
