"""The window around what matters in a picture."""

import numpy as np
import pytest

from torchhand.image.contours.windows import Window


def marked(*, left: int, top: int, right: int, bottom: int) -> np.ndarray:
    picture = np.zeros((60, 80), dtype=bool)
    picture[top, left] = picture[bottom, right] = True
    return picture


def test_the_box_and_a_margin() -> None:
    window = Window.around(marked(left=30, top=20, right=41, bottom=33), 5)
    assert (window.left, window.top, window.right, window.bottom) == (25, 15, 47, 39)
    picture = np.arange(60 * 80).reshape(60, 80)
    cut = picture[window.slices]
    assert cut.shape == (24, 22)
    assert cut[0, 0] == picture[15, 25]


@pytest.mark.parametrize("multiple", [2, 3, 7])
def test_sides_at_multiples_hold_the_box_and_stay_in_the_picture(multiple: int) -> None:
    for left, top, right, bottom in ((30, 20, 41, 33), (0, 1, 79, 59), (3, 3, 3, 3), (70, 50, 79, 58)):
        window = Window.around(marked(left=left, top=top, right=right, bottom=bottom), 4, multiple=multiple)
        assert window.left % multiple == window.top % multiple == 0
        assert window.right % multiple == 0 or window.right == 80
        assert window.bottom % multiple == 0 or window.bottom == 60
        assert 0 <= window.left <= max(0, left - 4)
        assert 0 <= window.top <= max(0, top - 4)
        assert min(80, right + 5) <= window.right <= 80
        assert min(60, bottom + 5) <= window.bottom <= 60
        assert window.left > left - 4 - multiple
        assert window.right < right + 5 + multiple


def test_nothing_marked_is_the_whole_picture() -> None:
    window = Window.around(np.zeros((60, 80), dtype=np.uint8), 5)
    assert (window.left, window.top, window.right, window.bottom) == (0, 0, 80, 60)
