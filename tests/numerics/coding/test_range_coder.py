"""The adaptive range coder: every sequence of bits comes back, at the length that its entropy says."""

import math
import random

import pytest

from torchhand.numerics.coding.range_coder import AdaptiveBit, AdaptiveMagnitude, RangeDecoder, RangeEncoder


@pytest.mark.parametrize("fraction", [0.001, 0.03, 0.5, 0.9, 1.0])
@pytest.mark.parametrize("count", [0, 1, 7, 20_000])
def test_bits_come_back(fraction: float, count: int) -> None:
    chance = random.Random(count)
    bits = [int(chance.random() < fraction) for _ in range(count)]
    encoder, model = RangeEncoder(), AdaptiveBit()
    for bit in bits:
        assert encoder.bit(model, bit) == bit
    data = encoder.finish()
    decoder, model = RangeDecoder(data), AdaptiveBit()
    assert [decoder.bit(model) for _ in bits] == bits


def test_length_is_the_entropy() -> None:
    chance = random.Random(3)
    count, fraction = 50_000, 0.04
    bits = [int(chance.random() < fraction) for _ in range(count)]
    ones = sum(bits) / count
    entropy = -count * (ones * math.log2(ones) + (1 - ones) * math.log2(1 - ones))
    encoder, model = RangeEncoder(), AdaptiveBit(memory=2000)
    for bit in bits:
        encoder.bit(model, bit)
    assert entropy * 0.97 < 8 * len(encoder.finish()) < entropy * 1.03


def test_many_models_and_plain_bits_mixed() -> None:
    chance = random.Random(5)
    script = [(chance.randrange(5), int(chance.random() < 0.1 * chance.randrange(10))) for _ in range(10_000)]
    outcome = []
    for coder in (encoder := RangeEncoder(), None):
        coder = coder or RangeDecoder(encoder.finish())
        models = [AdaptiveBit() for _ in range(4)]
        outcome.append(
            [coder.plain(bit) if which == 4 else coder.bit(models[which], bit) for which, bit in script]
            if coder is encoder
            else [coder.plain(0) if which == 4 else coder.bit(models[which], 0) for which, bit in script]
        )
    assert outcome[0] == outcome[1] == [bit for _, bit in script]


def test_carries_run_through_bytes_of_255() -> None:
    # 0 is coded at the top of the range: with it nearly certain, low comes to begin with bytes of 255 that wait, until
    # a later addition carries into them or not.
    longest = 0
    for seed in range(60):
        chance = random.Random(seed)
        script = [(chance.randrange(1, 1 << 16), chance.random()) for _ in range(150)]
        bits = [int(draw < 0.02) for _, draw in script]
        encoder, models = RangeEncoder(), [AdaptiveBit(chance=fraction / (1 << 16)) for fraction, _ in script]
        for model, bit in zip(models, bits, strict=True):
            encoder.bit(model, bit)
            longest = max(longest, encoder._carried)
        decoder, models = (
            RangeDecoder(encoder.finish()),
            [AdaptiveBit(chance=fraction / (1 << 16)) for fraction, _ in script],
        )
        assert [decoder.bit(model) for model in models] == bits, seed
    assert longest >= 1


@pytest.mark.parametrize("spread", [1, 3, 40, 10**9])
def test_magnitudes_come_back(spread: int) -> None:
    chance = random.Random(spread)
    numbers = [1 + int(chance.random() ** 3 * spread) for _ in range(400)]
    encoder, model = RangeEncoder(), AdaptiveMagnitude()
    assert [model.code(encoder, number) for number in numbers] == numbers
    decoder, model = RangeDecoder(encoder.finish()), AdaptiveMagnitude()
    assert [model.code(decoder, 0) for _ in numbers] == numbers


def test_bits_that_are_no_number_are_refused() -> None:
    encoder, model = RangeEncoder(), AdaptiveMagnitude(steps=1)
    encoder.bit(model._steps[0], 1)
    for _ in range(60):
        encoder.plain(1)
    decoder, model = RangeDecoder(encoder.finish()), AdaptiveMagnitude(steps=1)
    with pytest.raises(ValueError, match="expected an integer"):
        model.code(decoder, 0)


def test_chances_follow_the_bits_and_never_reach_certainty() -> None:
    model = AdaptiveBit(memory=50)
    for _ in range(10_000):
        model.learn(1)
    assert 65000 < model.chance < 65536
    for _ in range(10_000):
        model.learn(0)
    assert 0 < model.chance < 500
