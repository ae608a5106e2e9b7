"""Signals that rest or move in whole steps, as few bits: prediction from the frame before, in a closed loop.

`followed` makes whole steps of numbers; `RowEncoder` and `RowDecoder` turn tables of steps into bytes and back. What
is coded is the change since the row before; its bits are modelled by what the same channel and its partner did lately,
and the models learn as they go, the same on both sides. The decoder adds whole numbers up: nothing can drift.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64, Int64

from torchhand.numerics.coding.range_coder import AdaptiveBit, AdaptiveMagnitude, BitCoder, RangeDecoder, RangeEncoder

_AGES = (1, 2, 4, 8)
"""Rows since a channel's last change that count as different, the last and all above as one."""
_OLDEST = len(_AGES)
_RECENT = 2  # from this age class on, all are the same to sign and size
_CROWDS = (1, 2, 4)
"""Changes so far in a row that count as different."""
_NO_PARTNER = 3
_UNLIKELY = 0.3


def followed(
    values: Float64[np.ndarray, "rows channels"],
    dead_zone: float,
    *,
    start: Int64[np.ndarray, "channels"] | None = None,
) -> Int64[np.ndarray, "rows channels"]:
    """Whole numbers that follow the values: they stay as long as a value is less than `dead_zone` from them, and then
    go to the nearest. Never further than max(dead_zone, ½) away. start: those before the first row, where there are
    any.

    Raises ValueError for a dead zone below ½, which would let noise flicker, or above 1, and for values that are not
    finite.
    """
    if not 0.5 <= dead_zone <= 1:
        raise ValueError(f"dead_zone: expected 0.5 to 1, got {dead_zone!r}")
    if not np.isfinite(values).all():
        raise ValueError("values: expected finite numbers")
    rows = np.zeros(values.shape, dtype=np.int64)
    present = start
    for i, row in enumerate(values):
        nearest = np.rint(row).astype(np.int64)
        present = nearest if present is None else np.where(np.abs(row - present) < dead_zone, present, nearest)
        rows[i] = present
    return rows


class RowEncoder:
    """Turns tables of steps into bytes, block by block: each can be decoded as soon as it is whole."""

    def __init__(self, partners: Sequence[int | None]) -> None:
        """partners: for each channel an earlier one that tends to move with it, or None."""
        self._model = _ChangeModel(partners)
        self._last: np.ndarray = np.zeros(len(partners), dtype=np.int64)

    def block(self, rows: Int64[np.ndarray, "rows channels"]) -> bytes:
        """The next rows as bytes."""
        coder = RangeEncoder()
        for change in np.diff(rows, axis=0, prepend=self._last[None]).tolist():
            self._model.code(coder, change)
        self._last = rows[-1] if len(rows) else self._last
        return coder.finish()


class RowDecoder:
    """Turns the blocks of a `RowEncoder` with the same partners, in their order, back into rows."""

    def __init__(self, partners: Sequence[int | None]) -> None:
        self._model = _ChangeModel(partners)
        self._last = [0] * len(partners)

    def block(self, data: bytes, count: int) -> Int64[np.ndarray, "rows channels"]:
        """The `count` rows of a block.

        Raises ValueError for bytes that are no such table, as far as that can be told.
        """
        coder = RangeDecoder(data)
        rows = np.zeros((count, len(self._last)), dtype=np.int64)
        for i in range(count):
            change = self._model.code(coder, self._last)  # a decoder does not look at the values
            self._last = [value + step for value, step in zip(self._last, change, strict=True)]
            rows[i] = self._last
        return rows


class _ChangeModel:
    """What changes are likely; writes a row of them, or reads one."""

    def __init__(self, partners: Sequence[int | None]) -> None:
        channels = len(partners)
        for channel, partner in enumerate(partners):
            if partner is not None and not 0 <= partner < channel:
                raise ValueError(f"partners: expected earlier channels than {channel}, got {partner}")
        self._partners = list(partners)
        self._age, self._sign = [_AGES[-1]] * channels, [0] * channels
        self._moved = 0  # whether each of the last two rows had changes
        self._any: dict[int, AdaptiveBit] = {}
        self._changed: dict[tuple[int, ...], AdaptiveBit] = {}
        self._negative: dict[tuple[int, ...], AdaptiveBit] = {}
        self._size: dict[int, AdaptiveMagnitude] = {}

    def code(self, coder: BitCoder, change: Sequence[int]) -> list[int]:
        """Write the changes, or read them where the coder is a decoder."""
        has_any = coder.bit(self._any.setdefault(self._moved, AdaptiveBit()), int(any(change)))
        self._moved = 2 * (self._moved % 2) + has_any
        found = [0] * len(self._partners)
        if has_any:
            crowd = 0
            for channel, value in enumerate(change):
                found[channel] = self._one(coder, channel, value, crowd, found)
                crowd += found[channel] != 0
        for channel, value in enumerate(found):
            self._age[channel] = 1 if value else min(self._age[channel] + 1, _AGES[-1])
        return found

    def _one(self, coder: BitCoder, channel: int, value: int, crowd: int, found: Sequence[int]) -> int:
        partner = self._partners[channel]
        beside = None if partner is None else found[partner]
        age = sum(self._age[channel] > edge for edge in _AGES[:-1])
        nearby = _NO_PARTNER if beside is None else min(abs(beside), 2)
        context = (channel, age, sum(crowd >= edge for edge in _CROWDS), nearby)
        if context not in self._changed:
            self._changed[context] = AdaptiveBit(chance=_UNLIKELY)
        if not coder.bit(self._changed[context], int(value != 0)):
            return 0
        direction = 0 if not beside else 1 if beside > 0 else -1
        own = self._sign[channel] if age < _OLDEST - 1 else 0
        context = (channel if direction else -1, own, direction)
        is_negative = coder.bit(self._negative.setdefault(context, AdaptiveBit()), int(value < 0))
        size = self._size.setdefault(min(age, _RECENT), AdaptiveMagnitude()).code(coder, abs(value))
        self._sign[channel] = -1 if is_negative else 1
        return -size if is_negative else size
