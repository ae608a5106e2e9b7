"""What a tracker knows of the hand that it began with."""

import pytest

from torchhand.hand import posture
from torchhand.track import TrackerState


@pytest.mark.parametrize(("name", "is_open"), [("open", True), ("flat", True), ("point", False), ("fist", False)])
def test_a_hand_began_open_where_no_finger_is_bent_much(name: str, is_open: bool) -> None:
    assert TrackerState(posture=posture(name)).began_open is is_open


def test_a_hand_that_has_not_begun_has_not_begun_open() -> None:
    assert TrackerState().began_open is False
