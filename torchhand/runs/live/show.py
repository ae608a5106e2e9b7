"""A live run on a page: the newest frame is drawn in a thread of its own, so that the tracker never waits."""

import contextlib
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

from jaxtyping import Float
from torch import Tensor

from torchhand.files import FrameRecord, load_hand_model
from torchhand.hand import Side
from torchhand.runs.live.recorder import Recorder
from torchhand.runs.overlays import drawn_over
from torchhand.runs.recordings import LiveCamera, RecordedFrame
from torchhand.view import HandProjector
from torchhand.viewer import LivePage, address_of, opened_server

_MOST_PER_S = 12.0  # frames that are drawn


class LiveShow:
    """Gives the newest frame to a page, and pictures to the recorder."""

    def __init__(self, page: LivePage, recorder: Recorder, recording: LiveCamera) -> None:
        self.page, self.recorder, self._recording = page, recorder, recording
        self._changed, self._is_over = threading.Condition(), False
        self._newest: tuple[RecordedFrame, FrameRecord, HandProjector | None, Tensor | None] | None = None

    def offer(
        self,
        frame: RecordedFrame,
        record: FrameRecord,
        projector: HandProjector | None,
        shape: Float[Tensor, "shape"] | None,
    ) -> None:
        """A frame that was tracked. projector, shape: of the hand, once there is one."""
        image = frame.views[0].image
        if image is not None:
            self.recorder.add(frame.time_s, image, records=self.page.records)
        with self._changed:
            self._newest = (frame, record, projector, shape)
            self._changed.notify_all()

    def run(self) -> None:
        """Draw the newest frame, again and again, until `stop`."""
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._newest is not None or self._is_over)
                if self._is_over or self._newest is None:
                    return
                (frame, record, projector, shape), self._newest = self._newest, None
            image = frame.views[0].image
            picture = image if image is None or projector is None else drawn_over(image, projector, record)
            latency_s = self._recording.latency_s
            facts = {"pictures dropped": str(self._recording.dropped())}
            if latency_s is not None:
                facts["from picture to estimate"] = f"{1e3 * latency_s:.0f} ms"
            self.page.show(record, shape, picture, facts)
            with self._changed:
                self._changed.wait_for(lambda: self._is_over, timeout=1 / _MOST_PER_S)

    def stop(self) -> None:
        """End `run`."""
        with self._changed:
            self._is_over = True
            self._changed.notify_all()


@contextlib.contextmanager
def opened_show(
    port: int, recording: LiveCamera, side: Side, folder: Path, say: Callable[[str], None]
) -> Iterator[LiveShow]:
    """A page that shows a run until the block ends. folder: of the recordings.

    Raises InputError where viser is not installed.
    """
    with opened_server(port, title=f"torchhand: {recording.name}") as server:
        say(f"open {address_of(server)} in a browser to watch")
        recorder = Recorder(folder, recording.fps, say)
        show = LiveShow(LivePage(server, load_hand_model(), side), recorder, recording)
        thread = threading.Thread(target=show.run, name="page", daemon=True)
        thread.start()
        try:
            yield show
        finally:
            show.stop()
            thread.join()
            recorder.close()
