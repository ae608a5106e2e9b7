"""The hand that is meant among several, and what is kept of it."""

import math

import numpy as np
import torch

from torchhand.detect import chosen_hand, hand_keypoints
from torchhand.files import HandDetection
from torchhand.hand import Side


def _hand(x: float, side: Side | None, score: float) -> HandDetection:
    points = np.tile((x, 50.0), (21, 1)) + np.arange(21)[:, None]
    return HandDetection(picture=points, space=np.ones((21, 3)), confidence=None, label=side, score=score)


def test_the_nearest_hand_of_the_side_is_taken_whatever_its_score() -> None:
    near, far, other = _hand(110, "right", 0.5), _hand(400, "right", 0.99), _hand(100, "left", 0.99)
    followed = torch.full((21, 2), 100.0)
    assert chosen_hand([far, other, near], "right", followed) is near
    assert chosen_hand([far, other, near], "left", followed) is other


def test_without_a_followed_hand_the_best_score_is_taken() -> None:
    hands = [_hand(1, "right", 0.4), _hand(2, "right", 0.9), _hand(3, "left", 1.0), _hand(4, "right", math.nan)]
    assert chosen_hand(hands, "right") is hands[1]


def test_hands_of_the_other_side_are_none() -> None:
    assert chosen_hand([_hand(1, "left", 0.9)], "right") is None
    assert chosen_hand([], "right") is None


def test_a_hand_without_a_side_is_taken_for_either() -> None:
    hand = _hand(1, None, 0.9)
    assert chosen_hand([hand], "left") is hand
    assert chosen_hand([hand], "right") is hand


def test_points_that_are_missing_do_not_count_in_the_distance() -> None:
    near, far = _hand(110, "right", 0.5), _hand(400, "right", 0.5)
    assert near.picture is not None
    near.picture[3] = np.nan
    assert chosen_hand([far, near], "right", torch.full((21, 2), 100.0)) is near


def test_a_tracker_takes_points_and_score() -> None:
    seen = hand_keypoints(_hand(7, "right", 0.75))
    assert seen is not None
    assert seen.points is not None
    assert seen.score == 0.75
    torch.testing.assert_close(seen.points_px[2], torch.tensor((9.0, 52.0), dtype=torch.float64))
    assert hand_keypoints(None) is None


def test_without_a_score_of_the_hand_that_of_its_known_points_counts() -> None:
    points, confidence = np.zeros((21, 2)), np.full(21, 0.5)
    points[0], confidence[0] = np.nan, 0.0
    hand = HandDetection(picture=points, space=None, confidence=confidence)
    seen = hand_keypoints(hand)
    assert seen is not None
    assert seen.score == 0.5
    assert hand_keypoints(HandDetection(picture=np.full((21, 2), np.nan), space=None, confidence=confidence)) is None
