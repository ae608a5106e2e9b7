"""What the process that searches does: the tracker's own search, and the way to the newest picture."""

from collections.abc import Iterator
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any

import pytest
import torch

from tests.steps import right_hand
from torchhand.runs import settings_of
from torchhand.track import Tracker, TrackerState, View, restored_state, worker
from torchhand.track.messages import Search, SeenFrame, packed
from torchhand.track.worker import Inbox, Searcher


@pytest.fixture(scope="module")
def film(studio: Any) -> Any:
    return studio.film("planar", 4, total=14, pace=3.0)


@pytest.fixture
def ends() -> Iterator[tuple[Connection, Connection]]:
    here, there = Pipe()
    yield here, there
    here.close()
    there.close()


def seen(image: torch.Tensor, time_s: float) -> SeenFrame:
    return SeenFrame.of((View(image=image),), time_s)


def tracker_of(film: Any) -> Tracker:
    return Tracker(right_hand(), film.camera, settings_of("contour_planar"))


def test_a_hand_that_is_found_is_followed_to_the_newest_picture(film: Any) -> None:
    """As one tracker does that sees all of them, bit for bit."""
    frames = [seen(image, 0.1 * index) for index, image in enumerate(film.images)]
    later = iter([(frames[1], False), (frames[2], False), (frames[3], True)])
    answer = Searcher(tracker_of(film), lambda _, __: next(later))(Search(number=7, frame=frames[0], state=None))
    tracker, state = tracker_of(film), None
    for frame in frames:
        state, _ = tracker.step(state, frame.views, frame.time_s)
    assert answer.number == 7
    assert answer.state is not None
    found, expected = restored_state(answer.state), state
    assert isinstance(expected, TrackerState)
    assert found.time_s == expected.time_s
    assert found.hand is not None
    assert expected.hand is not None
    torch.testing.assert_close(found.hand.belief.mean, expected.hand.belief.mean, rtol=0, atol=0)
    torch.testing.assert_close(found.shape, expected.shape, rtol=0, atol=0)


def test_the_way_begins_with_the_very_next_pictures(film: Any) -> None:
    """Of a hand that was just found nobody knows how it moves."""
    frames = [seen(film.images[0], 0.03 * index) for index in range(6)]
    later, steps_s = iter([(frame, frame is frames[-1]) for frame in frames[1:]]), list[float]()

    def next_frame(_: float, step_s: float) -> tuple[SeenFrame, bool]:
        steps_s.append(step_s)
        return next(later)

    Searcher(tracker_of(film), next_frame)(Search(number=1, frame=frames[0], state=None))
    assert steps_s[:3] == [0.0] * 3
    assert min(steps_s[3:]) >= 0.1


@pytest.mark.parametrize("step_s", [0.4, 1.2, 2.0])
def test_a_still_hand_is_kept_on_a_slow_machine(film: Any, step_s: float) -> None:
    """Whose steps to the newest picture are long: what is known of the hand's motion is worth little there."""
    times_s = [0.0, *(index / 30 for index in (1, 2, 3)), *(0.1 + step_s * index for index in range(1, 13))]
    frames = [seen(film.images[0], time_s) for time_s in times_s]
    later = iter([(frame, frame is frames[-1]) for frame in frames[1:]])
    answer = Searcher(tracker_of(film), lambda _, __: next(later))(Search(number=1, frame=frames[0], state=None))
    assert answer.state is not None
    found, end_s = restored_state(answer.state), times_s[-1] + step_s
    tracker = tracker_of(film)
    _, expected = tracker.step(None, frames[0].views, 0.0)
    _, kept = tracker.step(found, frames[0].views, end_s, occasions=worker.FOLLOWING)
    assert found.time_s == times_s[-1]
    assert kept.keypoints is not None
    assert expected.keypoints is not None
    assert float((kept.keypoints - expected.keypoints).norm(dim=-1).max()) < 0.015


def test_where_no_hand_is_nothing_is_answered(film: Any) -> None:
    wall = torch.zeros_like(film.images[0]) + film.images[0][0, 0]
    search = Search(number=1, frame=seen(wall, 0.0), state=None)
    assert Searcher(tracker_of(film), lambda _, __: None)(search).state is None


def test_a_hand_that_is_lost_on_the_way_is_none(film: Any) -> None:
    """A first one that was never told of would be called recovered when it is found again."""
    wall = torch.zeros_like(film.images[0]) + film.images[0][0, 0]
    later = iter([(seen(wall, 0.1 * index), index == 30) for index in range(1, 31)])
    search = Search(number=1, frame=seen(film.images[0], 0.0), state=None)
    answer = Searcher(tracker_of(film), lambda _, __: next(later))(search)
    assert len(list(later)) < 30, "it was found"
    assert answer.state is None


def test_frames_are_passed_in_steps(ends: tuple[Connection, Connection]) -> None:
    here, there = ends
    inbox = Inbox(there)
    picture = torch.full((3, 4, 3), 7, dtype=torch.uint8)
    here.send_bytes(packed(Search(number=1, frame=seen(picture, 0.0), state=None)))
    assert inbox.next_request() is not None
    for index in range(1, 8):
        here.send_bytes(packed(seen(picture, index / 10)))
    here.close()
    assert inbox.next_request() is None  # all has been read
    taken, time_s, is_newest = [], 0.0, False
    while not is_newest:
        later = inbox.later_frame(time_s, 0.25)
        assert later is not None
        frame, is_newest = later
        time_s = frame.time_s
        taken.append(time_s)
    assert taken == [0.2, 0.4, 0.6, 0.7]
    assert frame.views[0].image is not None
    assert torch.equal(frame.views[0].image, picture)
    assert inbox.later_frame(time_s, 0.25) is None


def test_frames_that_wait_do_not_fill_the_memory(
    ends: tuple[Connection, Connection], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(worker, "_KEPT_BYTES", 36 * 10)
    here, there = ends
    inbox = Inbox(there)
    for index in range(50):
        here.send_bytes(packed(seen(torch.zeros(3, 4, 3, dtype=torch.uint8), index / 10)))
    here.close()
    assert inbox.next_request() is None
    times_s, is_newest = [0.0], False
    while not is_newest:
        later = inbox.later_frame(times_s[-1], 0.01)
        assert later is not None
        times_s.append(later[0].time_s)
        is_newest = later[1]
    assert len(times_s) <= 11
    assert times_s[-1] >= 4.8
