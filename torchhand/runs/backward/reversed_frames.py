"""A recording from its end to its beginning."""

from collections.abc import Iterator
from itertools import islice

from torchhand.runs.recording import RecordedFrame, Recording

_MEMORY_BYTES = 2**28  # of the pictures that are held at once


def reversed_frames(recording: Recording, count: int) -> Iterator[RecordedFrame]:
    """The first `count` frames, the last one first.

    Containers are not trusted to seek: the frames are read in order, as many at a time as fit into a part of the
    memory that does not grow with the recording, and those before them are skipped.
    """
    size = sum(3 * camera.width * camera.height for camera in recording.cameras)
    chunk = max(1, _MEMORY_BYTES // size)
    for begin in reversed(range(0, count, chunk)):
        with recording.opened(begin) as frames:
            held = list(islice(frames, min(chunk, count - begin)))
        while held:
            yield held.pop()
