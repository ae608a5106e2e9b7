"""A tracker's step computes on the calling thread alone, whatever the process has chosen, and leaves that as it was."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from torchhand.files import load_hand_model
from torchhand.track import Estimate, Tracker, TrackerState, View

OTHERS = 3


class _Threads(TorchDispatchMode):
    """Records with how many threads every operation of the calling thread computes."""

    def __init__(self) -> None:
        super().__init__()
        self.seen: set[int] = set()

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        self.seen.add(torch.get_num_threads())
        return func(*args, **(kwargs or {}))


@pytest.fixture
def several() -> Iterator[None]:
    """The process computes with some threads."""
    before = torch.get_num_threads()
    torch.set_num_threads(OTHERS)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def film(studio: Any) -> Any:
    return studio.film("planar", 3, total=14, pace=3.0)


def tracker_of(film: Any) -> Tracker:
    return Tracker(load_hand_model().hand(dtype=torch.float64), film.camera)


def tracked(tracker: Tracker, images: list[Tensor]) -> list[Estimate]:
    state: TrackerState | None = None
    estimates = []
    for index, image in enumerate(images):
        state, estimate = tracker.step(state, [View(image=image)], index / 30)
        estimates.append(estimate)
    return estimates


@pytest.mark.usefixtures("several")
def test_every_operation_of_a_step_has_one_thread(film: Any) -> None:
    tracker = tracker_of(film)
    state, _ = tracker.step(None, [View(image=film.images[0])], 0.0)
    with _Threads() as threads:
        _, estimate = tracker.step(state, [View(image=film.images[1])], 1 / 30)
    assert estimate.status == "tracked"
    assert threads.seen == {1}
    assert torch.get_num_threads() == OTHERS


@pytest.mark.usefixtures("several")
def test_two_trackers_in_two_threads_find_what_one_finds(film: Any) -> None:
    def followed(_: int) -> tuple[list[Estimate], int]:
        return tracked(tracker_of(film), film.images), torch.get_num_threads()

    alone = tracked(tracker_of(film), film.images)
    with ThreadPoolExecutor(2) as pool:
        both = list(pool.map(followed, range(2)))
    assert [count for _, count in both] == [OTHERS, OTHERS]
    for estimates, _ in both:
        for one, other in zip(alone, estimates, strict=True):
            assert one.status == other.status == "tracked"
            assert one.pose is not None
            assert other.pose is not None
            torch.testing.assert_close(other.pose, one.pose, rtol=0, atol=0)
