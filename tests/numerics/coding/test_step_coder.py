"""Signals in whole steps: the closed loop stays within its bound, tables come back exactly and are short."""

import numpy as np
import pytest

from torchhand.numerics.coding.step_coder import RowDecoder, RowEncoder, followed

PARTNERS = (None, 0, 1, None)


def _walk(rows: int, channels: int, seed: int, step: float) -> np.ndarray:
    generator = np.random.default_rng(seed)
    return np.cumsum(step * generator.standard_normal((rows, channels)), axis=0)


@pytest.mark.parametrize("dead_zone", [0.5, 0.6, 1.0])
def test_following_never_drifts(dead_zone: float) -> None:
    values = _walk(5000, 4, 1, 0.3)
    off = np.abs(followed(values, dead_zone) - values)
    assert off.max() <= max(dead_zone, 0.5)
    assert off[-500:].mean() < 1.2 * off[:500].mean() + 0.05  # no worse at the end than at the beginning


def test_a_dead_zone_keeps_noise_at_rest() -> None:
    values = 0.49 + 0.08 * np.random.default_rng(0).standard_normal((400, 1))
    flickers = [np.count_nonzero(np.diff(followed(values, zone), axis=0)) for zone in (0.5, 0.9)]
    assert flickers[0] > 20
    assert flickers[1] == 0


def _encoded(table: np.ndarray, partners: tuple[int | None, ...]) -> bytes:
    return RowEncoder(partners).block(table)


@pytest.mark.parametrize("rows", [0, 1, 2, 700])
@pytest.mark.parametrize("step", [0.0, 0.2, 50.0])
def test_tables_come_back(rows: int, step: float) -> None:
    table = np.rint(_walk(rows, 4, 2, step) + 17).astype(np.int64)
    for size in (13, 1000):
        encoder, decoder = RowEncoder(PARTNERS), RowDecoder(PARTNERS)
        blocks = [table[start : start + size] for start in range(0, rows, size)]
        found = [decoder.block(encoder.block(block), len(block)) for block in blocks]
        assert [block.shape for block in found] == [block.shape for block in blocks]
        assert all(np.array_equal(one, other) for one, other in zip(found, blocks, strict=True))


def test_a_channel_that_follows_another_costs_less_with_it_as_partner() -> None:
    others = np.rint(_walk(1200, 4, 4, 0.4)).astype(np.int64)
    table = np.concatenate((others, 2 * others[:, :1]), 1)
    four = len(_encoded(others, (None,) * 4))
    alone, together = (len(_encoded(table, (None,) * 4 + (partner,))) for partner in (None, 0))
    assert together - four < 0.65 * (alone - four)


def test_rest_is_nearly_free() -> None:
    table = np.tile(np.array([[5, -3, 0, 900]]), (10_000, 1))
    assert len(_encoded(table, PARTNERS)) < 70


def test_the_same_bytes_every_time() -> None:
    table = np.rint(_walk(300, 4, 8, 0.5)).astype(np.int64)
    assert _encoded(table, PARTNERS) == _encoded(table.copy(), PARTNERS)
    # Written down once: a change of the format shows here.
    assert _encoded(np.array([[1, -2], [1, -2], [2, -1]]), (None, 0)).hex() == "1b22"


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: followed(np.zeros((2, 1)), 0.4), "dead_zone: expected 0.5 to 1, got 0.4"),
        (lambda: followed(np.array([[np.nan]]), 0.5), "values: expected finite numbers"),
        (lambda: RowEncoder((None, 1)), "partners: expected earlier channels"),
    ],
)
def test_wrong_arguments(call, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()
