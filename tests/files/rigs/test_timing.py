"""Pictures of several cameras paired by time: against a plain search over all pairs, and on what cameras really do."""

import numpy as np
import pytest

from torchhand.files.rigs.timing import is_constant, pair_times


def _plain(frame_s: float, times: np.ndarray, reach_s: float) -> int:
    """The nearest of these times by trying all."""
    best = min(range(len(times)), key=lambda number: abs(times[number] - frame_s))
    return best if abs(times[best] - frame_s) <= reach_s else -1


def test_cameras_of_one_rate_are_paired_by_number() -> None:
    times = np.arange(50) / 30
    pairs = pair_times([times, times.copy(), times + 0.004])
    assert np.array_equal(pairs.numbers, np.repeat(np.arange(50)[:, None], 3, 1))
    assert np.abs(pairs.time_s - times).max() < 1e-12
    assert pairs.furthest_s == pytest.approx(0.004)
    assert pairs.fps == pytest.approx(30.0)


def test_the_slowest_camera_makes_the_frames() -> None:
    """30 and 25 frames a second: the nearest of the faster one's pictures each, half an interval away at most."""
    fast, slow = np.arange(90) / 30, np.arange(75) / 25
    pairs = pair_times([fast, slow])
    assert np.array_equal(pairs.numbers[:, 1], np.arange(len(pairs)))
    expected = [_plain(time_s, fast, 1) for time_s in slow[: len(pairs)]]
    assert np.array_equal(pairs.numbers[:, 0], expected)
    assert pairs.furthest_s <= 0.5 / 30 + 1e-12
    assert len(np.unique(pairs.numbers[:, 0])) == len(pairs)


@pytest.mark.parametrize("seed", range(5))
def test_uneven_cameras(seed: int) -> None:
    """Jittering times and dropped pictures: each picture in one frame at most, in order, never further away than half
    an interval, and where a frame has none of a camera, none was free within reach."""
    generator = np.random.default_rng(seed)
    times = []
    for fps in (30.0, 24.0, 60.0):
        own = np.arange(int(4 * fps)) / fps + generator.uniform(0, 0.3 / fps, int(4 * fps))
        times.append(np.sort(own[generator.random(len(own)) > 0.1]) - own[0])
    pairs = pair_times(times)
    steps = [(own[-1] - own[0]) / (len(own) - 1) for own in times]
    assert (np.diff(pairs.time_s) > 0).all()
    first_s = times[1][pairs.numbers[:, 1].max()] - pairs.time_s[pairs.numbers[:, 1].argmax()]
    first_s -= pairs.apart_s[pairs.numbers[:, 1].argmax(), 1]
    for view, own in enumerate(times):
        found = pairs.numbers[:, view]
        taken = found[found >= 0]
        assert (np.diff(taken) > 0).all()
        assert np.nanmax(np.abs(pairs.apart_s[:, view])) <= 0.5 * steps[view] + 1e-3
        for frame in np.flatnonzero(found < 0):
            nearest = _plain(first_s + pairs.time_s[frame], own, 0.5 * steps[view])
            assert nearest == -1 or nearest in taken


def test_the_others_go_on_in_a_camera_s_gap() -> None:
    slow = np.delete(np.arange(40) / 20, range(10, 20))  # half a second without a picture
    fast = np.arange(60) / 30
    pairs = pair_times([slow, fast])
    inside = (pairs.time_s > 0.46) & (pairs.time_s < 0.99)
    assert (pairs.numbers[inside, 0] == -1).all()
    assert (pairs.numbers[inside, 1] >= 0).all()
    assert np.diff(pairs.time_s).max() < 0.11
    assert (pairs.numbers[~inside] >= 0).all()


def test_frames_begin_and_end_with_all_cameras() -> None:
    early, late = np.arange(60) / 30, 0.5 + np.arange(60) / 30
    pairs = pair_times([early, late])
    assert (pairs.numbers[0].tolist(), pairs.numbers[-1].tolist()) == ([15, 0], [59, 44])
    assert pairs.time_s[0] == 0
    assert pairs.every(4).numbers.tolist() == pairs.numbers[::4].tolist()
    with pytest.raises(ValueError, match="the cameras' times have nothing in common"):
        pair_times([early, early + 10.0])


def test_constant_rates() -> None:
    times = np.arange(1000) / 29.97
    assert is_constant(times, 29.97)
    assert is_constant(np.round(times, 3), 29.97)  # as a container with milliseconds has them
    assert not is_constant(times, 30.3)
    assert not is_constant(np.delete(times, 500), 29.97)
