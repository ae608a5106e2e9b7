"""Which side of a hand the camera sees."""

import math

import pytest
import torch

from torchhand.fit.detect.facing import facing_rotation, turned_in_picture


@pytest.mark.parametrize("side", ["palm", "back"])
@pytest.mark.parametrize("turn", [0.0, 1.0, 3.0, -2.0])
def test_turns_in_the_picture_are_clockwise_and_keep_the_side(side: str, turn: float) -> None:
    before, after = facing_rotation(side), turned_in_picture(facing_rotation(side), turn)
    torch.testing.assert_close(after[:, 0], before[:, 0], atol=1e-15, rtol=0)  # the axis through the palm
    fingers = torch.tensor((math.sin(turn), -math.cos(turn), 0.0), dtype=torch.float64)
    torch.testing.assert_close(after[:, 1], fingers, atol=1e-15, rtol=0)


def test_a_side_that_is_none() -> None:
    with pytest.raises(ValueError, match="facing: expected one of palm, back, got 'edge'"):
        facing_rotation("edge")
