"""One hand in pictures that follow one another: how many are looked for, and which is followed."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from torchhand.detect import HandDetector, Landmarks
from torchhand.files import HandDetection
from torchhand.hand import Side

IMAGE = torch.zeros(4, 4, 3, dtype=torch.uint8)


def _hand(x: float, side: Side, score: float = 0.9) -> HandDetection:
    return HandDetection(picture=np.full((21, 2), float(x)), space=None, confidence=None, label=side, score=score)


@dataclass
class Scripted:
    """Gives the hands of a script, picture by picture, the best first and no more than asked for (`Landmarker`)."""

    script: list[list[HandDetection]]
    name: str = "scripted"
    opened: list[int] = field(default_factory=list)
    place: int = 0

    def open(self, hands: int) -> Landmarks:
        self.opened.append(hands)
        whole = self

        class Found:
            def detect(self, image: Tensor) -> Sequence[HandDetection]:
                del image
                hands_here = whole.script[whole.place]
                return hands_here[:hands]

            def close(self) -> None:
                pass

        return Found()


def _seen(detector: HandDetector, landmarker: Scripted) -> list[float | None]:
    found = []
    for place in range(len(landmarker.script)):
        landmarker.place = place
        seen = detector(IMAGE)
        found.append(None if seen is None else float(seen.points_px[0, 0]))
    return found


def test_two_hands_are_looked_for_only_from_where_one_is_of_the_other_side() -> None:
    script = [[_hand(1, "right")], [_hand(1, "right"), _hand(9, "left")], [_hand(9, "left"), _hand(1, "right")]]
    landmarker = Scripted(script)
    detector = HandDetector(side="right", landmarker=landmarker)
    assert _seen(detector, landmarker) == [1, 1, 1]
    assert landmarker.opened == [1, 2]


def test_one_hand_alone_is_looked_for_once() -> None:
    landmarker = Scripted([[_hand(1, "right")], [], [_hand(2, "right")]])
    assert _seen(HandDetector(side="right", landmarker=landmarker), landmarker) == [1, None, 2]
    assert landmarker.opened == [1]


def test_the_hand_that_was_last_seen_is_followed() -> None:
    script = [
        [_hand(5, "left", 0.99), _hand(1, "right", 0.9)],
        [_hand(9, "right", 0.99), _hand(2, "right", 0.5)],
        [_hand(9, "right", 0.99), _hand(3, "right", 0.5)],
    ]
    landmarker = Scripted(script)
    assert _seen(HandDetector(side="right", landmarker=landmarker), landmarker) == [1, 2, 3]


def test_hands_of_the_other_side_are_counted() -> None:
    landmarker = Scripted([[_hand(1, "left")], [_hand(1, "left")], []])
    detector = HandDetector(side="right", landmarker=landmarker)
    assert _seen(detector, landmarker) == [None, None, None]
    assert detector.other_hands == 2
