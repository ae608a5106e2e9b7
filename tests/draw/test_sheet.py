"""Contact sheets."""

import pytest
import torch

from torchhand.draw.sheet import contact_sheet


def test_pictures_stand_row_by_row() -> None:
    frames = [torch.full((4, 6, 3), value, dtype=torch.uint8) for value in (10, 20, 30, 40, 50)]
    sheet = contact_sheet(frames, 3, gap_px=2, gap_level=7)
    assert tuple(sheet.shape) == (2 * 4 + 2, 3 * 6 + 2 * 2, 3)
    for i, frame in enumerate(frames):
        top, left = (i // 3) * 6, (i % 3) * 8
        assert torch.equal(sheet[top : top + 4, left : left + 6], frame)
    assert (sheet[4:6] == 7).all()
    assert (sheet[:, 6:8] == 7).all()
    assert (sheet[6:, 16:] == 7).all()


def test_fewer_pictures_than_columns() -> None:
    frame = torch.zeros(2, 3, 3, dtype=torch.uint8)
    assert tuple(contact_sheet([frame], 5).shape) == (2, 3, 3)


def test_wrong_wishes_are_named() -> None:
    small, large = torch.zeros(2, 3, 3, dtype=torch.uint8), torch.zeros(4, 3, 3, dtype=torch.uint8)
    with pytest.raises(ValueError, match="frames: expected at least one"):
        contact_sheet([], 2)
    with pytest.raises(ValueError, match="columns: expected 1 or more, got 0"):
        contact_sheet([small], 0)
    with pytest.raises(ValueError, match="expected pictures of 3x2 px, got 3x4"):
        contact_sheet([small, large], 2)
