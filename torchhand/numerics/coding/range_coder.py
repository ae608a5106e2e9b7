"""An adaptive binary range coder: bits with learned probabilities to bytes and back, on integers alone.

The same bits come out on every machine, because no floating-point number takes part. The coder is Martin's range coder
(1979) in the form of LZMA: 32 bits of range, carries resolved by a byte that waits. A coder is an encoder or a decoder;
code that models data is written once for both: it says `coder.bit(model, value)` and goes on with what comes back.
"""

_ONE = 1 << 16
_TOP, _MASK = 1 << 24, 0xFFFFFFFF
_FIRST_BYTES = 5
_LONGEST_ESCAPE = 40  # bits of an integer's Exp-Golomb tail


class AdaptiveBit:
    """The chance that a bit is 1, learned from those seen so far: quickly at first, then as a moving average."""

    __slots__ = ("_memory", "_seen", "chance")

    def __init__(self, *, memory: int = 100, chance: float = 0.5) -> None:
        """memory: over how many bits it averages in the end, 2 or more. chance: before the first one."""
        self.chance = min(max(round(chance * _ONE), 1), _ONE - 1)
        """That the next bit is 1, of 65536."""
        self._memory = memory
        self._seen = 1

    def learn(self, bit: int) -> None:
        """Take notice of a bit."""
        self._seen = min(self._seen + 1, self._memory)
        towards = _ONE - 32 if bit else 32
        self.chance += (towards - self.chance) // self._seen if bit else -((self.chance - towards) // self._seen)


class RangeEncoder:
    """Takes bits; `finish` gives the bytes."""

    def __init__(self) -> None:
        self._low, self._range = 0, _MASK
        self._waiting, self._carried = 0, 0
        self._is_first = True
        self._bytes = bytearray()

    def bit(self, model: AdaptiveBit, value: int) -> int:
        """Write a bit, of which the model then learns; returns it."""
        bound = (self._range >> 16) * model.chance
        if value:
            self._range = bound
        else:
            self._low += bound
            self._range -= bound
        model.learn(value)
        self._shift()
        return value

    def plain(self, value: int) -> int:
        """Code a bit that is 0 or 1 with equal chance."""
        self._range >>= 1
        if not value:
            self._low += self._range
        self._shift()
        return value

    def finish(self) -> bytes:
        """All bytes; no bit may follow. Zeros at the end are left out: a decoder reads zeros beyond the end."""
        # Any number from low up to low + range will do: the one with most zeros at its end.
        for zeros in range(32, -1, -1):
            rounded = -(-self._low >> zeros) << zeros
            if rounded < self._low + self._range:
                self._low = rounded
                break
        for _ in range(_FIRST_BYTES):
            self._push()
        return bytes(self._bytes).rstrip(b"\0")

    def _shift(self) -> None:
        while self._range < _TOP:
            self._range = self._range << 8 & _MASK
            self._push()

    def _push(self) -> None:
        """Move the highest byte out; bytes of 255 wait for a carry."""
        if self._low < 0xFF000000 or self._low > _MASK:
            carry = self._low >> 32
            if not self._is_first:
                self._bytes.append(self._waiting + carry & 0xFF)
            self._is_first = False
            self._bytes.extend([0xFF + carry & 0xFF] * self._carried)
            self._carried = 0
            self._waiting = self._low >> 24 & 0xFF
        else:
            self._carried += 1
        self._low = self._low << 8 & _MASK


class RangeDecoder:
    """Gives back the bits of the same models in the same order."""

    def __init__(self, data: bytes) -> None:
        self._data, self._place = data, 0
        self._range, self._code = _MASK, 0
        for _ in range(_FIRST_BYTES - 1):
            self._code = self._code << 8 | self._next()

    def bit(self, model: AdaptiveBit, value: int = 0) -> int:
        """Read a bit, whatever `value` is."""
        bound = (self._range >> 16) * model.chance
        found = int(self._code < bound)
        if found:
            self._range = bound
        else:
            self._code -= bound
            self._range -= bound
        model.learn(found)
        self._shift()
        return found

    def plain(self, value: int = 0) -> int:
        """Code a bit that is 0 or 1 with equal chance."""
        self._range >>= 1
        found = int(self._code < self._range)
        if not found:
            self._code -= self._range
        self._shift()
        return found

    def _shift(self) -> None:
        while self._range < _TOP:
            self._range = self._range << 8 & _MASK
            self._code = (self._code << 8 | self._next()) & _MASK

    def _next(self) -> int:
        self._place += 1
        return self._data[self._place - 1] if self._place <= len(self._data) else 0


BitCoder = RangeEncoder | RangeDecoder
"""What modelling code needs: the same calls write or read."""


class AdaptiveMagnitude:
    """Integers from 1 up: a step at a time as long as that is likely, with an Exp-Golomb tail."""

    def __init__(self, *, steps: int = 12, memory: int = 100) -> None:
        self._steps = [AdaptiveBit(memory=memory, chance=0.4) for _ in range(steps)]

    def code(self, coder: BitCoder, value: int) -> int:
        """Write `value`, 1 or more, or read one. Raises ValueError for bits that are no number's."""
        for step, model in enumerate(self._steps, start=1):
            if not coder.bit(model, int(value > step)):
                return step
        rest = value - len(self._steps)  # 1 or more
        length = max(rest, 1).bit_length()
        found = 1
        while coder.plain(int(length > found)):
            found += 1
            if found > _LONGEST_ESCAPE:
                raise ValueError("code: expected an integer, got bits that are none's")
        amount = 1
        for place in range(found - 2, -1, -1):
            amount = amount << 1 | coder.plain(rest >> place & 1)
        return len(self._steps) + amount
