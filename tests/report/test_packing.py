"""Packed arrays: within half a step, gaps kept, and refused where they do not fit."""

import numpy as np
import pytest

from tests.report.reading import unpacked
from torchhand.report.packing import Kind, packed, packed_range


@pytest.mark.parametrize("shape", [(7,), (1,), (300, 5), (4, 3, 2)])
@pytest.mark.parametrize(("kind", "largest"), [("i1", 127), ("i2", 32767), ("i4", 2**31 - 1)])
def test_values_come_back_within_half_a_step(shape: tuple[int, ...], kind: Kind, largest: int) -> None:
    random = np.random.default_rng(0)
    values = random.uniform(-1, 1, shape) * 0.01 * largest  # differences run over the type's range
    if values.size > 1:
        values.flat[::3] = np.nan
        values.flat[1] = 0.01 * largest
    found = unpacked(packed(values, kind, step=0.01))
    assert found.shape == values.shape
    np.testing.assert_allclose(found, values, rtol=0, atol=0.00501)


def test_a_range_that_16_bits_do_not_hold_gets_a_coarser_step() -> None:
    values = np.array([3.0, 1000.0, np.nan, -200.0, 77.77])
    content = packed_range(values, step=1e-4)
    assert content["step"] == pytest.approx(1200 / 65534)
    np.testing.assert_allclose(unpacked(content), values, rtol=0, atol=0.51 * content["step"])
    np.testing.assert_array_equal(unpacked(packed_range(np.full((4, 2), np.nan), step=1.0)), np.full((4, 2), np.nan))


def test_what_does_not_fit_is_refused() -> None:
    for values, kind in (([128.0], "i1"), ([-1.0], "u1"), ([255.0], "u1")):
        with pytest.raises(ValueError, match="expected them within the range"):
            packed(np.array(values), kind)  # pyright: ignore[reportArgumentType] - of Kind


def test_steady_motion_packs_small() -> None:
    """An hour of 30 angles at 30 frames a second that change slowly takes less than half a byte a value."""
    time = np.arange(10_000)[:, None] / 30
    values = 40 * np.sin(0.5 * time + np.arange(30))
    assert len(packed(values, "i2", step=0.01)["data"]) < 1.0 * values.size
