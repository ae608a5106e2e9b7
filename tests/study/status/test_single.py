"""The model by which a hand in a single picture is believed: what it learns, and on which pictures it is measured."""

import pytest
import torch

from torchhand.study.status import WeighedPicture, evidence_table
from torchhand.track.single import EVIDENCE


def _pictures(count: int, *, has_hand: bool, of: str) -> list[WeighedPicture]:
    """Each with two hands, of which the first is the right one where there is one; the overlap tells it."""
    generator = torch.Generator().manual_seed(int(has_hand))
    found = []
    for number in range(count):
        evidence = torch.randn(2, len(EVIDENCE), generator=generator, dtype=torch.float64)
        overlap = torch.full((2,), torch.nan, dtype=torch.float64)
        if has_hand:
            evidence[0, 0] += 6
            overlap = torch.tensor((0.9, 0.3), dtype=torch.float64)
        found.append(WeighedPicture(name=f"{of}_{number}", evidence=evidence, overlap=overlap, has_hand=has_hand))
    return found


def test_what_tells_right_hands_from_others_has_the_weight_and_the_rates_hold_on_other_pictures() -> None:
    pictures = [
        *_pictures(60, has_hand=True, of="one"),
        *_pictures(60, has_hand=True, of="other"),
        *_pictures(100, has_hand=False, of="one"),
        *_pictures(100, has_hand=False, of="other"),
    ]
    table = evidence_table(pictures, ["other*"])
    assert max(table["weights"], key=table["weights"].__getitem__) == EVIDENCE[0]
    for name in ("fitted", "held_out"):
        assert table["overlap"][name] == {"pictures": 60, "median": 0.9, "below_0.75": 0.0}
        row = table[name]["0.05"]
        assert row["pictures"] == [60, 100]
        assert row["hands"] > 0.9
        assert row["without"] <= 0.12  # 5 % of 100, within three standard deviations


def test_a_picture_in_which_nothing_was_weighed_counts_as_one_without_a_report() -> None:
    nothing = WeighedPicture(
        name="wall",
        evidence=torch.zeros(0, len(EVIDENCE), dtype=torch.float64),
        overlap=torch.zeros(0, dtype=torch.float64),
        has_hand=False,
    )
    pictures = [*_pictures(20, has_hand=True, of="one"), *_pictures(20, has_hand=False, of="one"), *[nothing] * 20]
    row = evidence_table(pictures, [])["fitted"]["0.1"]
    assert row["pictures"] == [20, 40]
    assert row["without"] == 0.1


def test_too_few_pictures_are_refused() -> None:
    with pytest.raises(ValueError, match=r"got 5 right hands and 0 pictures without a hand"):
        evidence_table(_pictures(5, has_hand=True, of="one"), [])
