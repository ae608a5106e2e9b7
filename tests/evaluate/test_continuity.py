"""Losses and recoveries counted by hand."""

import pytest

from torchhand.evaluate.continuity import Continuity, continuity

LETTERS = {"t": "tracked", "l": "lost", "r": "recovered", "n": "no_hand"}


@pytest.mark.parametrize(
    ("letters", "followed", "until_loss", "losses", "to_recover"),
    [
        ("tttt", 4, None, 0, ()),
        ("nnttlltt", 4, 2, 1, (2,)),
        ("tlrtlnnrl", 4, 1, 3, (1, 3)),
        ("nnn", 0, None, 0, ()),
        ("ttnn", 2, 2, 1, ()),
        ("", 0, None, 0, ()),
    ],
)
def test_counts(letters: str, followed: int, until_loss: int | None, losses: int, to_recover: tuple[int, ...]) -> None:
    assert continuity([LETTERS[letter] for letter in letters]) == Continuity(
        frames=len(letters),
        followed=followed,
        frames_until_first_loss=until_loss,
        losses=losses,
        frames_to_recover=to_recover,
    )


def test_an_unknown_status_is_refused() -> None:
    with pytest.raises(ValueError, match="expected one of tracked, recovered, lost, no_hand, got 'gone'"):
        continuity(["tracked", "gone"])
