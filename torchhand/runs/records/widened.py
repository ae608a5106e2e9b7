"""What the pictures of a recording leave open, in the covariances of its records."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float

from torchhand.files import FrameRecord
from torchhand.hand import HandPose
from torchhand.track import Alternatives, HandPath, path_weights


@dataclass(frozen=True, kw_only=True)
class _Open:
    """What one picture leaves open about the hand of a record."""

    keypoints: Float[np.ndarray, "21 3 3"]
    """Square metres: mean square of how far the alternatives lie from it."""
    pose: Float[np.ndarray, "36"]
    """The same of the pose, the root's rotation as a small turn in the world's axes."""

    def towards(self, other: "_Open", share: float) -> "_Open":
        """What is left open between two pictures, a share of the way from this one to the other."""
        return _Open(
            keypoints=(1 - share) * self.keypoints + share * other.keypoints,
            pose=(1 - share) * self.pose + share * other.pose,
        )


def widened(records: Sequence[FrameRecord], alternatives: Mapping[int, Alternatives]) -> list[FrameRecord]:
    """Records of one camera with the spread of the hands that explain the pictures about as well, the mixture's and not
    the winner's.

    alternatives: by the place of their record. Between two records that have some, what they leave open is interpolated
    linearly; a hidden Markov model over these weighs them, as they move in relation to the records' hands
    (`path_weights`).
    """
    looked = [row for row in sorted(alternatives) if np.isfinite(records[row].keypoints3d).all()]
    if not looked:
        return list(records)
    found = [alternatives[row] for row in looked]
    hands = [records[row] for row in looked]
    weights = _weights(hands, found)
    left = [_left_open(*one) for one in zip(hands, found, weights, strict=True)]

    def at(row: int) -> _Open:
        place = float(np.interp(row, looked, range(len(looked))))
        first = int(place)
        return left[first].towards(left[min(first + 1, len(left) - 1)], place - first)

    return [
        _with(record, at(row)) if np.isfinite(record.keypoints3d).all() else record
        for row, record in enumerate(records)
    ]


def _weights(hands: Sequence[FrameRecord], found: Sequence[Alternatives]) -> list[Float[torch.Tensor, "k"]]:
    """Probabilities of the alternatives of every picture, all pictures considered."""
    most = max(len(one.correlated_cost) for one in found)
    away = torch.full((len(found), most, 21, 3), torch.nan, dtype=torch.float64)
    evidence = torch.zeros(len(found), most, dtype=torch.float64)
    for row, (hand, one) in enumerate(zip(hands, found, strict=True)):
        count = len(one.correlated_cost)
        away[row, :count] = one.keypoints - torch.from_numpy(hand.keypoints3d)
        evidence[row, :count] = -one.correlated_cost
    weights = path_weights([HandPath(keypoints=away[:, i], evidence=evidence[:, i]) for i in range(most)])
    return [weights[row, : len(one.correlated_cost)] for row, one in enumerate(found)]


def _left_open(hand: FrameRecord, found: Alternatives, weights: Float[torch.Tensor, "k"]) -> _Open:
    share, points = weights.numpy(), found.keypoints.numpy()
    own = np.broadcast_to(hand.keypoints3d, points.shape)
    away = points - own
    at = HandPose.of(torch.from_numpy(hand.pose))
    missed = np.stack([at.step_to(found.pose[row]).numpy() for row in range(len(points))])
    return _Open(
        keypoints=np.einsum("k,kji,kjl->jil", share, away, away),
        pose=share @ missed**2,
    )


def _with(record: FrameRecord, left: _Open) -> FrameRecord:
    is_free = record.pose_std > 0
    return replace(
        record,
        pose_std=np.where(is_free, np.sqrt(record.pose_std**2 + left.pose), record.pose_std),
        keypoints3d_cov=record.keypoints3d_cov + left.keypoints,
    )
