"""Line charts, read back from their pixels."""

import math

import pytest
import torch
from torch import Tensor

from torchhand.draw.chart import LINE_COLOURS, Axes, draw_chart, tick_step

FIELD = slice(0, -40)
"""Rows above the names of the lines."""


def _is(picture: Tensor, colour: tuple[int, int, int]) -> Tensor:
    return (picture.int() - torch.tensor(colour, dtype=torch.int32)).abs().amax(-1) < 40


def test_a_line_goes_where_its_values_say() -> None:
    picture = draw_chart(Axes("", size_px=(400, 300)), [0, 5, 10], {"": [0.0, 10.0, 10.0]})
    rows, columns = _is(picture, LINE_COLOURS[0])[FIELD].nonzero().unbind(-1)
    left, right, top, bottom = (int(x) for x in (columns.min(), columns.max(), rows.min(), rows.max()))
    assert 40 < left < 80
    assert 360 < right < 400
    assert abs(float(rows[columns == (left + right) // 2].double().mean()) - top) < 4
    assert abs(float(rows[columns == (3 * left + right) // 4].double().mean()) - (top + bottom) / 2) < 4


def test_levels_are_dashed_and_scale_the_axis() -> None:
    plain = draw_chart(Axes(""), [0, 1], {"a": [1.0, 1.0]})
    both = draw_chart(Axes(""), [0, 1], {"a": [1.0, 1.0]}, levels={"b": 2.0})
    rows = [float(_is(picture, LINE_COLOURS[0])[FIELD].nonzero()[:, 0].double().mean()) for picture in (plain, both)]
    assert rows[1] > rows[0] + 50
    dashes = _is(both, LINE_COLOURS[1])[FIELD]
    row = int(dashes.sum(1).argmax())
    steps = dashes[row].int().diff().abs().sum()
    assert int(steps) > 20
    assert 0.3 < float(dashes[row, 80:440].double().mean()) < 0.7


def test_what_is_not_finite_is_left_out() -> None:
    known = draw_chart(Axes("t"), [0, 1, 3], {"a": [1.0, 2.0, 3.0]})
    holed = draw_chart(Axes("t"), [0, 1, 2, 3], {"a": [1.0, 2.0, math.nan, 3.0]}, levels={"b": math.nan})
    assert torch.equal(known, holed)
    empty = draw_chart(Axes("t"), [], {"a": []})
    assert empty.shape == (320, 480, 3)
    assert not bool(_is(empty, LINE_COLOURS[0])[FIELD].any())


def test_a_band_lies_behind_its_line_and_dots_mark_values() -> None:
    plain = draw_chart(Axes("", y_end=10, size_px=(400, 300)), [0, 10], {"": [5.0, 5.0]})
    bands = {"": ([4.0, 4.0], [7.0, 7.0])}
    banded = draw_chart(Axes("", y_end=10, size_px=(400, 300)), [0, 10], {"": [5.0, 5.0]}, bands=bands)
    line = _is(plain, LINE_COLOURS[0])[FIELD]
    assert bool((_is(banded, LINE_COLOURS[0])[FIELD] == line).all())
    changed = (banded != plain).any(-1)[FIELD]
    rows = changed[:, 150].nonzero()[:, 0]
    up = float(line[:, 150].nonzero()[:, 0].double().mean())
    tenth = (300 - 62 - 34) / 10
    assert float(rows.min()) == pytest.approx(up - 2 * tenth, abs=2)
    assert float(rows.max()) == pytest.approx(up + tenth, abs=2)
    dotted = draw_chart(Axes("", y_end=10, size_px=(400, 300)), [0, 10], {"": [5.0, 5.0]}, has_dots=True)
    single = draw_chart(Axes("", y_end=10, size_px=(400, 300)), [10], {"": [5.0]}, has_dots=True)
    assert int(_is(dotted, LINE_COLOURS[0])[FIELD].sum()) > int(line.sum()) + 20
    assert int(_is(single, LINE_COLOURS[0])[FIELD].sum()) > 20


def test_the_axis_ends_where_it_is_told() -> None:
    half, own = (draw_chart(Axes("", y_end=y_end), [0, 1], {"": [5.0, 5.0]}) for y_end in (10, None))
    high = draw_chart(Axes("", y_end=10), [0, 1], {"": [50.0, 50.0]})
    places = [float(_is(one, LINE_COLOURS[0])[FIELD].nonzero()[:, 0].double().mean()) for one in (half, own, high)]
    assert places[0] == pytest.approx((320 - 62 + 34) / 2, abs=1)
    assert places[1] == pytest.approx(34, abs=1)
    assert places[2] == pytest.approx(34, abs=1)  # what is beyond lies on the end


@pytest.mark.parametrize(
    ("largest", "step"), [(1.0, 0.2), (10.0, 2.0), (24.0, 5.0), (0.031, 0.01), (4000.0, 1000.0), (25.0, 5.0)]
)
def test_ticks_are_round(largest: float, step: float) -> None:
    assert tick_step(largest) == pytest.approx(step)
    assert 2 <= largest / tick_step(largest) <= 5.01


def test_mistakes_are_named() -> None:
    with pytest.raises(ValueError, match="a: expected 2 values, as many as x has, got 1"):
        draw_chart(Axes(""), [0, 1], {"a": [1.0]})
    for bands in ({"b": ([0.0, 0.0], [1.0, 1.0])}, {"a": ([0.0], [1.0, 1.0])}):
        with pytest.raises(
            ValueError, match=r"band of '[ab]': expected a line of that name, and 2 values at either end"
        ):
            draw_chart(Axes(""), [0, 1], {"a": [1.0, 2.0]}, bands=bands)
    with pytest.raises(ValueError, match="size: expected at least 160x120 px, got 100x300"):
        draw_chart(Axes("", size_px=(100, 300)), [0, 1], {"a": [1.0, 2.0]})
