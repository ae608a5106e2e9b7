"""Pairing by time stamps, without threads or clocks: in time, stalled, dropping, ending, too fast."""

import pytest
import torch
from torch import Tensor

from torchhand.files.live.pairing import LivePictures, LiveSettings, Pairing

PERIOD_S = 1 / 30


def picture(value: int) -> Tensor:
    return torch.full((2, 2, 3), value, dtype=torch.uint8)


def values(found: LivePictures | None) -> list[int | None]:
    assert found is not None
    return [None if image is None else int(image[0, 0, 0]) for image in found.images]


def test_pictures_of_one_time_come_together_whatever_their_order() -> None:
    pairing = Pairing(2, LiveSettings())
    for frame in range(5):
        stamp_s = frame * PERIOD_S
        first, second = (0, 1) if frame % 2 else (1, 0)
        pairing.add(first, stamp_s + 0.004 * first, picture(frame), stamp_s + 0.01, number=0)
        assert pairing.ready(stamp_s + 0.01) is None
        pairing.add(second, stamp_s + 0.004 * second, picture(frame), stamp_s + 0.02, number=0)
        found = pairing.ready(stamp_s + 0.02)
        assert found is not None
        assert values(found) == [frame, frame]
        assert found.time_s == pytest.approx(stamp_s)
        assert pairing.ready(stamp_s + 0.02) is None
    assert pairing.taken == [5, 5]
    assert pairing.dropped == [0, 0]


def test_a_camera_that_stalls_is_waited_for_a_while_and_comes_back() -> None:
    pairing = Pairing(2, LiveSettings(patience_s=0.1))
    seen = []
    for frame in range(12):
        stamp_s = frame * PERIOD_S
        pairing.add(0, stamp_s, picture(frame), stamp_s, number=0)
        if not 3 <= frame < 9:
            pairing.add(1, stamp_s, picture(frame), stamp_s, number=0)
        if (found := pairing.ready(stamp_s)) is not None:
            seen.append(values(found))
    # Frames 3 to 5 wait for the other camera, the newest of them goes without; those before it are dropped.
    assert seen == [[0, 0], [1, 1], [2, 2], [6, None], [7, None], [8, None], [9, 9], [10, 10], [11, 11]]
    assert pairing.dropped == [3, 0]


def test_a_camera_that_drops_frames_leaves_gaps_and_no_wrong_pairs() -> None:
    pairing = Pairing(2, LiveSettings())
    seen = []
    for frame in range(9):
        stamp_s = frame * PERIOD_S
        pairing.add(0, stamp_s, picture(frame), stamp_s, number=0)
        if frame % 3:
            pairing.add(1, stamp_s, picture(frame), stamp_s, number=0)
        if (found := pairing.ready(stamp_s)) is not None:
            seen.append(values(found))
    assert all(one == other for one, other in seen)
    assert [one for one, _ in seen] == [1, 2, 4, 5, 7, 8]
    assert pairing.dropped == [3, 0]


def test_a_camera_that_ends_is_not_waited_for() -> None:
    pairing = Pairing(2, LiveSettings())
    pairing.add(0, 0.0, picture(0), 0.0, number=0)
    pairing.add(1, 0.0, picture(0), 0.0, number=0)
    pairing.end(1)
    assert not pairing.is_over
    assert values(pairing.ready(0.0)) == [0, 0]
    pairing.add(0, PERIOD_S, picture(1), PERIOD_S, number=0)
    assert values(pairing.ready(PERIOD_S)) == [1, None]
    pairing.end(0)
    assert pairing.is_over


def test_who_is_slow_gets_the_newest_and_the_rest_is_counted() -> None:
    pairing = Pairing(2, LiveSettings())
    for frame in range(10):
        for camera in range(2):
            pairing.add(camera, frame * PERIOD_S, picture(frame), frame * PERIOD_S, number=0)
    found = pairing.ready(0.5)
    assert found is not None
    assert values(found) == [9, 9]
    assert pairing.dropped == [9, 9]
    pairing.add(0, 8 * PERIOD_S, picture(8), 0.6, number=0)  # older than what was handed out
    assert pairing.ready(0.6) is None
    assert pairing.dropped == [10, 9]


def test_times_only_advance_and_every_picture_is_told_of(generator: torch.Generator) -> None:
    settings, jitter_s = LiveSettings(tolerance_s=0.01), 0.03
    pairing, given, last_s = Pairing(3, settings), [0, 0, 0], -1.0
    for frame in range(200):
        for camera in torch.randperm(3, generator=generator).tolist():
            if float(torch.rand((), generator=generator)) < 0.2:
                continue
            stamp_s = frame * PERIOD_S + jitter_s * float(torch.rand((), generator=generator))
            pairing.add(camera, stamp_s, picture(frame % 256), (frame + 1) * PERIOD_S, number=0)
            given[camera] += 1
            found = pairing.ready((frame + 1) * PERIOD_S)
            if found is not None:
                assert found.time_s > last_s
                last_s = found.time_s
    for camera in range(3):
        pairing.end(camera)
    while pairing.ready(1e3) is not None:
        pass
    assert pairing.is_over
    assert [taken + dropped for taken, dropped in zip(pairing.taken, pairing.dropped, strict=True)] == given
    assert min(pairing.taken) > 60


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"tolerance_s": 0.0}, "live.tolerance_s: expected above 0 and finite"),
        ({"tolerance_s": 0.5}, "live.patience_s: expected 0.5"),
        ({"patience_s": float("inf")}, "live.patience_s"),
    ],
)
def test_settings_that_cannot_be(settings: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        LiveSettings(**settings)
