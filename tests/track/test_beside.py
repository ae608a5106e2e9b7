"""A tracker whose searches run in another process."""

import multiprocessing
import os
import pickle
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from tests.steps import FRAME_S, right_hand
from torchhand.cluster import can_copy_process
from torchhand.devices import HOST
from torchhand.runs import settings_of
from torchhand.track import OCCASIONS, STILL_SEARCHED, Estimate, SearchBeside, Tracker, TrackerState, View
from torchhand.track.messages import READY, Answer, Search, packed

QUICK = ("always", "detected")
PATIENCE_S = 120.0  # for another process on a machine with other work
_APART_S = 1e-3  # time from picture to picture while a hand is searched


@pytest.fixture(scope="module")
def film(studio: Any) -> Any:
    return studio.film("planar", 3, total=14, pace=3.0)


def test_a_step_that_may_not_search_tells_that_one_is_due(film: Any) -> None:
    tracker = Tracker(right_hand(), film.camera, settings_of("contour_planar"))
    views = [View(image=film.images[0])]
    _, quick = tracker.step(None, views, 0.0, occasions=QUICK)
    state, whole = tracker.step(None, views, 0.0, occasions=OCCASIONS)
    _, after = tracker.step(state, [View(image=film.images[1])], FRAME_S, occasions=QUICK)
    assert (quick.status, quick.is_doubted) == ("no_hand", True)
    assert (whole.status, whole.is_doubted) == ("tracked", False)
    assert (after.status, after.is_doubted) == ("tracked", False)


def test_a_hand_that_another_tracker_followed_takes_the_place_of_a_lost_one(film: Any) -> None:
    tracker = Tracker(right_hand(), film.camera, settings_of("contour_planar"))
    first, second, third = ([View(image=image)] for image in film.images)
    wall = [View(image=torch.zeros_like(film.images[0]) + film.images[0][0, 0])]
    other, _ = tracker.step(None, first, 0.0)
    lost, other = other, tracker.step(other, second, FRAME_S)[0]
    for index in range(4):
        lost, _ = tracker.step(lost, wall, FRAME_S * (1 + 0.1 * index), occasions=QUICK)
    assert lost.hand is None
    _, alone = tracker.step(lost, third, 2 * FRAME_S, occasions=QUICK)
    _, joined = tracker.step(lost, third, 2 * FRAME_S, occasions=QUICK, other=other)
    _, expected = tracker.step(other, third, 2 * FRAME_S)
    assert alone.pose is None
    assert joined.status == "recovered"
    assert joined.pose is not None
    assert expected.pose is not None
    torch.testing.assert_close(joined.pose, expected.pose, rtol=0, atol=1e-6)


def test_a_hand_is_found_while_steps_go_on(film: Any) -> None:
    make = partial(Tracker, right_hand(), film.camera, settings_of("contour_planar"))
    _, expected = make().step(None, [View(image=film.images[0])], 0.0)
    assert expected.keypoints is not None
    with SearchBeside(make) as beside:
        estimates = _until_tracked(beside, film)
        assert {(one.status, one.reason) for one in estimates[:-1]} == {("no_hand", STILL_SEARCHED)}
        found = estimates[-1].keypoints
        assert found is not None
        assert float((found - expected.keypoints).norm(dim=-1).max()) < 0.005
        _, forgotten = beside.step(None, [View(image=film.images[0])], 0.0)
        assert forgotten.status == "no_hand"
        assert _until_tracked(beside, film)[-1].status == "tracked"  # and is found anew


class _NoProcess:
    """In the place of `multiprocessing`'s context: the other process is the test itself."""

    def __init__(self) -> None:
        self.here, self.there = multiprocessing.Pipe()

    def Pipe(self) -> tuple[Any, Any]:
        return self.here, SimpleNamespace(close=lambda: None)

    def Process(self, **_: Any) -> Any:
        return SimpleNamespace(start=lambda: None, kill=lambda: None, join=lambda: None)


def test_all_pictures_near_a_search_are_sent_then_some(film: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    context = _NoProcess()
    monkeypatch.setattr("torchhand.track.messages.get_context", lambda _: context)
    make = partial(Tracker, right_hand(), film.camera, settings_of("contour_planar"))
    with SearchBeside(make) as beside:
        context.there.send_bytes(packed(READY))
        state = None
        for index in range(12):
            state, _ = beside.step(state, [View(image=film.images[0])], index * FRAME_S)
        messages = []
        while context.there.poll(1.0):
            messages.append(pickle.loads(context.there.recv_bytes()))
    assert isinstance(messages[0], Search)
    sent = [round(message.time_s / FRAME_S) for message in messages[1:]]
    assert sent == [1, 2, 3, 4, 7, 10]


def test_a_search_in_vain_tells_why_until_the_next_hand(film: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    context = _NoProcess()
    monkeypatch.setattr("torchhand.track.messages.get_context", lambda _: context)
    views = [View(image=film.images[0])]
    with SearchBeside(partial(Tracker, right_hand(), film.camera, settings_of("contour_planar"))) as beside:
        context.there.send_bytes(packed(READY))
        state, first = beside.step(None, views, 0.0)
        asked = pickle.loads(context.there.recv_bytes())
        context.there.send_bytes(packed(Answer(number=asked.number, seconds=0.1, state=None, reason="a wall")))
        _, second = beside.step(state, views, FRAME_S)
        _, forgotten = beside.step(None, views, 2 * FRAME_S)
    assert [one.reason for one in (first, second, forgotten)] == [STILL_SEARCHED, "a wall", STILL_SEARCHED]


SCRIPT = """
from functools import partial
import threading
import time
import torch
from tests.steps import right_hand
from tests.studio import Studio
from torchhand.runs import settings_of
from torchhand.track import SearchBeside, Tracker, View
print("once", flush=True)
if HAS_THREAD:
    threading.Thread(target=time.sleep, args=(600,), daemon=True).start()
wall = torch.zeros(160, 200, 3, dtype=torch.uint8)
with SearchBeside(partial(Tracker, right_hand(), Studio().camera(), settings_of("contour_planar"))) as beside:
    begun_s, state = time.monotonic(), None
    while not beside.is_ready:
        state, _ = beside.step(state, [View(image=wall)], time.monotonic() - begun_s)
        time.sleep(0.1)
print("ready", beside._process._is_copy)
"""


@pytest.mark.parametrize("has_thread", [False, True])
def test_a_script_needs_no_guard(tmp_path: Path, *, has_thread: bool) -> None:
    """Ten lines of a newcomer have none: the other process must not run them again. It is a copy of the first one
    unless threads are at work there."""
    script, root = tmp_path / "script.py", Path(__file__).parents[2]
    script.write_text(SCRIPT.replace("HAS_THREAD", str(has_thread)), encoding="utf-8")
    ran = subprocess.run(
        [sys.executable, str(script)],
        capture_output=True,
        text=True,
        timeout=2 * PATIENCE_S,
        env=os.environ | {"PYTHONPATH": str(root)},
        check=False,
    )
    is_copy = can_copy_process(HOST) and not has_thread
    assert (ran.returncode, ran.stdout) == (0, f"once\nready {is_copy}\n"), ran.stderr


def _until_tracked(beside: SearchBeside, film: Any) -> list[Estimate]:
    """The same picture again and again, a little time apart however long steps and the search take: to a tracker,
    pictures that are some tenths of a second apart may show a hand that is elsewhere."""
    state: TrackerState | None = None
    estimates: list[Estimate] = []
    begun_s = time.monotonic()
    while not estimates or estimates[-1].pose is None:
        assert time.monotonic() - begun_s < PATIENCE_S
        state, estimate = beside.step(state, [View(image=film.images[0])], _APART_S * (1 + len(estimates)))
        estimates.append(estimate)
        time.sleep(FRAME_S)
    return estimates


def _failing_there(film: Any) -> Tracker:
    if multiprocessing.parent_process() is not None:
        raise ValueError("no memory left")
    return Tracker(right_hand(), film.camera, settings_of("contour_planar"))


def test_what_goes_wrong_there_is_told_here(film: Any) -> None:
    with SearchBeside(partial(_failing_there, film)) as beside, pytest.raises(RuntimeError, match="no memory left"):
        _until_tracked(beside, film)
