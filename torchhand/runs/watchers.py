"""Everything that looks at the frames of one camera while they are tracked: streams, the page, the overlay."""

import contextlib
from collections.abc import Callable, Iterator

from torchhand.devices import HOST
from torchhand.files import FrameRecord, TrackWriter
from torchhand.files.results import OVERLAY_NAME
from torchhand.runs.live import opened_show
from torchhand.runs.overlays import draw_live
from torchhand.runs.recordings import LiveCamera, OneCameraRecording, RecordedFrame
from torchhand.runs.request import Request
from torchhand.runs.run import Run, Say
from torchhand.runs.streams import PoseRate, message_of, opened_pose_files, opened_streams
from torchhand.view import HandProjector

Watch = Callable[[RecordedFrame, FrameRecord], None]


@contextlib.contextmanager
def opened_watchers(
    run: Run, recording: OneCameraRecording | LiveCamera, writer: TrackWriter, request: Request, say: Say
) -> Iterator[Watch]:
    """A function that is to be called with every frame once it is tracked."""
    side = request.known_side
    is_drawn = recording.is_live and request.has_overlay and not request.is_live
    with contextlib.ExitStack() as stack:
        draw = stack.enter_context(draw_live(writer.folder / OVERLAY_NAME if is_drawn else None, recording))
        streams = stack.enter_context(opened_streams(request.streams))
        files = stack.enter_context(
            opened_pose_files(request.streams, PoseRate(recording.fps, request.max_gap_s), side, say)
        )
        show = None
        if isinstance(recording, LiveCamera) and request.page_port is not None:
            show = stack.enter_context(opened_show(request.page_port, recording, side, writer.out_dir, say))

        def watch(frame: RecordedFrame, record: FrameRecord) -> None:
            if streams:
                message = message_of(record, side=side)
                for stream in streams:
                    stream.send(message)
            for file in files:
                file.take(record, run.shape)
            if is_drawn:
                draw(projector_of(run), frame, record)
            if show is not None:
                show.offer(frame, record, projector_of(run) if run.shape is not None else None, run.shape)
                if show.page.takes_restart():
                    say(f"the hand is forgotten after frame {frame.index}, and found anew")
                    run.restart()

        yield watch


def projector_of(run: Run) -> HandProjector:
    """What projects poses into the pictures of one camera."""
    return HandProjector(run.kinematics, run.tracker.own_cameras[0].to(device=HOST), run.shape)
