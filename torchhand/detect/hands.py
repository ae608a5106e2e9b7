"""Which of several detected hands is meant, and what a tracker takes of it."""

import math
from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.files import HandDetection
from torchhand.hand import Side
from torchhand.track import HandKeypoints


def chosen_hand(
    hands: Sequence[HandDetection], side: Side, followed_px: Float[Tensor, "21 2"] | None = None
) -> HandDetection | None:
    """The hand of a side that lies nearest to a followed hand's keypoints; the one with the best score where none is
    followed. None where all hands are of the other side."""
    own = [hand for hand in hands if hand.label in (side, None)]
    if not own:
        return None
    if followed_px is not None:
        return min(own, key=lambda hand: _distance_px(hand, followed_px))
    return max(own, key=lambda hand: -1.0 if math.isnan(hand.score) else hand.score)


def hand_keypoints(hand: HandDetection | None) -> HandKeypoints | None:
    """What a tracker takes of a detected hand; None where no point in the picture (px) is known."""
    if hand is None or hand.picture is None:
        return None
    points = torch.from_numpy(hand.picture[:, :2])
    is_known = points.isfinite().all(-1)
    if not bool(is_known.any()):
        return None
    score = hand.score
    if math.isnan(score):  # the hand's, where the detector tells; else the mean of its points
        score = 1.0 if hand.confidence is None else float(torch.from_numpy(hand.confidence)[is_known].mean())
    space = None if hand.space is None else torch.from_numpy(hand.space)
    return HandKeypoints(points_px=points, points=space, score=score)


def _distance_px(hand: HandDetection, followed_px: Tensor) -> float:
    """Mean distance of the known points; infinite where none is known."""
    if hand.picture is None:
        return math.inf
    away = np.linalg.norm(hand.picture[:, :2] - followed_px.double().cpu().numpy(), axis=-1)
    return float(away[np.isfinite(away)].mean()) if np.isfinite(away).any() else math.inf
