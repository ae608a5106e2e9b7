"""Which side of a hand the camera sees."""

import math

import pytest
import torch

from torchhand.fit.detect.facing import facing_rotation, shows_same_side, turned_in_picture
from torchhand.geometry import rotation_from_vector


@pytest.mark.parametrize("turn", [0.0, 1.0, 3.0, -2.0])
def test_turns_in_the_picture_keep_the_side(turn: float) -> None:
    palm, back = facing_rotation("palm"), facing_rotation("back")
    assert shows_same_side(palm, turned_in_picture(palm, turn))
    assert shows_same_side(turned_in_picture(back, turn), back)
    assert not shows_same_side(palm, turned_in_picture(back, turn))


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.6, 0.8, 0.0)])
def test_a_hand_is_turned_over_beyond_a_right_angle(axis: tuple[float, float, float]) -> None:
    palm = facing_rotation("palm")
    for degrees, is_same in ((60.0, True), (89.0, True), (91.0, False), (170.0, False)):
        turn = rotation_from_vector(math.radians(degrees) * torch.tensor(axis, dtype=torch.float64))
        assert shows_same_side(turn @ palm, palm) == is_same


def test_a_side_that_is_none() -> None:
    with pytest.raises(ValueError, match="facing: expected one of palm, back, got 'edge'"):
        facing_rotation("edge")
