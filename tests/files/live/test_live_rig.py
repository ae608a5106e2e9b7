"""Files played as if live, in threads: one that ends early, one that stalls, one with unreadable frames."""

import threading
from collections.abc import Iterator

import pytest
import torch

from torchhand.errors import InputError
from torchhand.files import LiveRig, LiveSettings
from torchhand.files.pictures import Frame, FrameSource

COUNT = 12


class Played(FrameSource):
    """Frames that show their number."""

    def __init__(self, name: str, frames: int = COUNT, *, bad: tuple[int, ...] = (), fps: float = 60.0) -> None:
        self.name, self.fps, self.count, self.width, self.height = name, fps, frames, 4, 3
        self._bad, self.is_closed = bad, False

    def __iter__(self) -> Iterator[Frame]:
        for index in range(self.count or 0):
            is_bad = index in self._bad
            image = None if is_bad else torch.full((3, 4, 3), index, dtype=torch.uint8)
            yield Frame(index=index, time_s=index / self.fps, image=image, problem="corrupt" if is_bad else None)

    def close(self) -> None:
        self.is_closed = True


class Stalling(Played):
    """Delivers three frames, then nothing until it is let go."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.go_on = threading.Event()

    def __iter__(self) -> Iterator[Frame]:
        for frame in super().__iter__():
            if frame.index == 3:
                self.go_on.wait(30)
                return
            yield frame


def test_the_pictures_of_one_time_come_together_and_all_are_counted() -> None:
    sources = [Played("one"), Played("two", bad=(2, 5)), Played("short", frames=4)]
    with LiveRig(sources, LiveSettings(patience_s=5.0)) as rig:
        assert rig.sizes == ((4, 3),) * 3
        found = list(rig)
        counts = rig.counts()
    assert all(source.is_closed for source in sources)
    times = [one.time_s for one in found]
    assert times == sorted(set(times))
    for one in found:
        shown = {int(image[0, 0, 0]) for image in one.images if image is not None}
        assert len(shown) == 1
        assert one.time_s == pytest.approx(shown.pop() / 60)
    assert [one.taken + one.dropped + one.unreadable for one in counts] == [COUNT, COUNT, 4]
    assert [one.unreadable for one in counts] == [0, 2, 0]
    last = found[-1].images
    assert last[0] is not None
    assert last[2] is None


def test_a_camera_that_stalls_does_not_stop_the_others() -> None:
    stalled = Stalling("stalled")
    with LiveRig([Played("one", 40), stalled], LiveSettings(patience_s=0.05)) as rig:
        found = []
        for one in rig:
            found.append(one)
            if one.images[1] is None and len(found) > 3:
                break
        stalled.go_on.set()
    assert found[-1].images[0] is not None


def test_a_camera_whose_pictures_change_their_size_ends_with_its_reason() -> None:
    class Broken(Played):
        def __iter__(self) -> Iterator[Frame]:
            yield from list(super().__iter__())[:2]
            raise InputError("broken, frame 2: expected a picture of 4x3 px like the first, got 8x6")

    with LiveRig([Played("one"), Broken("broken")], LiveSettings(patience_s=5.0)) as rig:
        found = list(rig)
        one, broken = rig.counts()
    assert one.problem is None
    assert broken.problem is not None
    assert "expected a picture of 4x3" in broken.problem
    assert found[-1].images[0] is not None


def test_no_cameras_are_refused() -> None:
    with pytest.raises(InputError, match="live: expected one camera or more, got none"):
        LiveRig([])


class Broken(Played):
    """The stream of a network camera, which nobody knows the length of, that breaks off after a few frames."""

    def __init__(self, name: str, frames: int = COUNT) -> None:
        super().__init__(name, frames)
        self._frames, self.count = frames, None

    def __iter__(self) -> Iterator[Frame]:
        self.count = self._frames
        yield from super().__iter__()
        self.count = None


def test_the_stream_of_a_network_camera_is_opened_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Once it comes back at the third try, then no more; every picture is counted, and the end is told."""
    answers: list[FrameSource | None] = [Broken("gate", 4), None, None, Broken("gate", 6)]

    def opened(address: str) -> FrameSource:
        answer = answers.pop(0) if answers else None
        if answer is None:
            raise InputError(f"{address}: cannot be read (Connection refused)")
        return answer

    monkeypatch.setattr("torchhand.files.live.rig.open_source", opened)
    monkeypatch.setattr("torchhand.files.live.rig._BETWEEN_TRIES_S", 0.01)
    monkeypatch.setattr("torchhand.files.live.rig._TRIED_AGAIN_S", 0.2)
    with LiveRig(["rtsp://127.0.0.1/gate"]) as rig:
        found = list(rig)
        [counts] = rig.counts()
    assert counts.taken + counts.dropped == 10
    assert counts.reconnected == 1
    assert counts.problem is not None
    assert counts.problem.startswith("ended at ")
    assert all(one.images[0] is not None for one in found)


def test_a_stream_that_is_a_file_is_not_begun_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Over HTTP, and one over RTSP that has come to the end that it promised."""
    opened = list[str]()

    def source(address: str) -> FrameSource:
        opened.append(address)
        return Played("clip") if address.startswith("rtsp") else Broken("clip")

    monkeypatch.setattr("torchhand.files.live.rig.open_source", source)
    for address in ("http://127.0.0.1/clip.ts", "rtsp://127.0.0.1/clip"):
        opened.clear()
        with LiveRig([address]) as rig:
            list(rig)
        assert opened == [address]
        assert rig.counts()[0].reconnected == 0
