"""The silhouette of a hand where a detector's keypoints are: for pictures whose colours do not tell it."""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from torchhand.devices import on_host
from torchhand.hand import FINGER_CHAINS, KEYPOINTS
from torchhand.image import clean, enlarged_mask, graph_cut, hand_region

_SIDE_PX = 200  # of the reduced part of the picture that is cut, at most
_AROUND = 0.6  # that part reaches so far beyond the keypoints; this and the next eight: lengths of the palm
_INSIDE, _LIKELY = 0.06, 0.18  # thickness of the bones that are hand for sure, and of fingers
_PALM_RIM = 0.08  # flesh beside the bones of the palm
_BESIDE_FINGERS, _BESIDE_PALM = 0.05, 0.2  # how far beyond these a hand may reach
_ARM_HALF, _ARM_LENGTH = 0.28, 0.4  # half the breadth of the forearm, and how much of it is looked at
_REACH = 2.0  # from the middle knuckle no finger reaches farther, lengths of the palm
_ELSEWHERE, _LACKING = 0.02, 0.2
"""Of a hand's area: what has its colours elsewhere, and what of it has not, by which these do not tell it. Before a
clutter with skin's colours the first is 0.03 to 0.9, or the second 0.2 to 0.3; of 45 photographs of signs the first is
more in four, on simulated hands before rooms and walls hardly ever."""
_PALM_OF_FINGERS, _PALM_OF_BREADTH = 0.5, 1.2  # a palm's length is that share of a chain of bones, and of its breadth
_PALM = [0, *(chain[1] for chain in FINGER_CHAINS)]  # with the thumb's base


@dataclass(frozen=True)
class CutAtKeypoints:
    """Appearance of a hand that colours alone do not tell from its surroundings: of a grey picture, or one with more
    skin. In place of `Appearance`."""

    def probability(
        self, image: UInt8[Tensor, "height width 3"], points_px: Float[Tensor, "21 2"]
    ) -> Float[Tensor, "height width"] | None:
        """1 where the picture shows the hand, else 0; None where its keypoints do not tell it."""
        mask = cut_at_keypoints(image, points_px)
        return None if mask is None else mask.float()


@on_host
def cut_at_keypoints(
    image: UInt8[Tensor, "height width 3"], points_px: Float[Tensor, "21 2"]
) -> Bool[Tensor, "height width"] | None:
    """What a graph cut takes for the hand between its bones and what is too far from these (`graph_cut`).

    With the beginning of the forearm. points_px: of the hand in the picture. None where one is missing, or none lies
    in the picture.
    """
    height, width = int(image.shape[0]), int(image.shape[1])
    points = points_px.double().numpy()
    if not np.isfinite(points).all():
        return None
    palm_px = _palm_length(points)
    left, top = np.clip(np.floor(points.min(0) - _AROUND * palm_px), 0, (width, height)).astype(int)
    right, bottom = np.clip(np.ceil(points.max(0) + _AROUND * palm_px), 0, (width, height)).astype(int)
    if min(right - left, bottom - top) < 2:
        return None
    scale = min(1.0, _SIDE_PX / max(right - left, bottom - top))
    size = max(1, round(scale * (right - left))), max(1, round(scale * (bottom - top)))
    part = cv2.resize(image[top:bottom, left:right].contiguous().numpy(), size, interpolation=cv2.INTER_AREA)
    inside, likely, reach = _drawn((points - (left, top) + 0.5) * scale - 0.5, scale * palm_px, part.shape[:2])
    if not inside.any():
        return None
    cut = graph_cut(torch.from_numpy(part), likely, inside=inside, outside=~reach)
    whole = torch.zeros(height, width, dtype=torch.bool)
    whole[top:bottom, left:right] = enlarged_mask(cut, int(bottom - top), int(right - left))
    return whole if bool(whole.any()) else None


@on_host
def are_colours_shared(
    probability: Float[Tensor, "height width"], cut: Bool[Tensor, "height width"], points_px: Float[Tensor, "21 2"]
) -> bool:
    """Whether a hand's colours do not tell it from its surroundings, or do not tell all of it.

    probability: that a pixel has its colours. cut: the hand as it is cut out at its keypoints, in the picture. They are
    shared where things ahead of the wrist have them that lie too far from the knuckles to be its fingers: others that
    have them are likely to lie behind the hand. That cut and colours differ about the hand tells nothing: the
    detector may have folded a finger that stretches.
    """
    points, coloured = points_px.double(), clean(probability > 0.5)
    size, knuckle = (cut.shape[0], cut.shape[1]), points[KEYPOINTS.index("middle_mcp")]
    area, reach_px = max(int(cut.sum()), 1), _REACH * _palm_length(points.numpy())
    x, y = torch.arange(size[1]) - knuckle[0], (torch.arange(size[0]) - knuckle[1])[:, None]
    elsewhere = coloured & hand_region(size, points[0], knuckle) & (x * x + y * y > reach_px**2)
    return int(elsewhere.sum()) > _ELSEWHERE * area or int((cut & ~coloured).sum()) > _LACKING * area


def _palm_length(points: np.ndarray) -> float:
    """Pixels from the wrist to the knuckles, as far as a hand that is seen askew tells it."""
    chains = max(
        float(np.linalg.norm(np.diff(points[list(chain)], axis=0), axis=1).sum()) for chain in FINGER_CHAINS[1:]
    )
    middle, breadth = np.linalg.norm(points[0] - points[9]), np.linalg.norm(points[5] - points[17])
    return max(float(middle), _PALM_OF_BREADTH * float(breadth), _PALM_OF_FINGERS * chains, 1.0)


def _drawn(
    points: np.ndarray, palm_px: float, size: tuple[int, int]
) -> tuple[Bool[Tensor, "height width"], Bool[Tensor, "height width"], Bool[Tensor, "height width"]]:
    """What is hand for sure, what is likely to be, and all that may be."""
    palm, arm = np.zeros(size, np.uint8), np.zeros(size, np.uint8)
    cv2.fillPoly(palm, [_rounded(points[_PALM])], 1)
    cv2.fillPoly(arm, [_rounded(_forearm(points, palm_px))], 1)
    rimmed = _widened(palm, _PALM_RIM * palm_px)
    bones = [rimmed, rimmed | arm]
    for drawn, share in zip(bones, (_INSIDE, _LIKELY), strict=True):
        for chain in FINGER_CHAINS:
            cv2.polylines(drawn, [_rounded(points[list(chain)])], False, 1, max(1, round(share * palm_px)))
    inside, likely = bones
    reach = _widened(likely, _BESIDE_FINGERS * palm_px) | _widened(palm | arm, _BESIDE_PALM * palm_px)
    return torch.from_numpy(inside > 0), torch.from_numpy(likely > 0), torch.from_numpy(reach > 0)


def _forearm(points: np.ndarray, palm_px: float) -> np.ndarray:
    """Corners of the beginning of the forearm, behind the wrist."""
    along = points[0] - points[9]
    along = along / max(float(np.linalg.norm(along)), 1e-9)
    across, wrist = np.array((-along[1], along[0])) * _ARM_HALF * palm_px, points[0]
    end = wrist + _ARM_LENGTH * palm_px * along
    return np.stack((wrist + across, end + across, end - across, wrist - across))


def _rounded(points: np.ndarray) -> np.ndarray:
    return np.round(points).astype(np.int32).reshape(-1, 1, 2)


def _widened(mask: np.ndarray, radius_px: float) -> np.ndarray:
    side = 2 * max(1, round(radius_px)) + 1
    return cv2.dilate(mask, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)))
