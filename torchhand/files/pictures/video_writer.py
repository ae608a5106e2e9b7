"""Writing a video that browsers play (H.264 in MP4), moved into place only when it is whole."""

import contextlib
import math
import os
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8
from torch import Tensor

from torchhand.errors import DiskError, InputError
from torchhand.files.disk import explained_errors, temporary_path
from torchhand.files.pictures.frame_source import ASSUMED_FPS

_ENCODERS = ("libx264", "libopenh264")
_SPEED, _QUALITY = {"libx264": {"preset": "superfast"}}, {"libx264": {"crf": "23"}}
_THREADS = {"threads": "2", "thread_type": "frame"}
"""A frame is encoded while the caller makes the next one; as many on every machine, so that the bits are the same."""
_SMALLEST_SIDE = 16
_MAX_DENOMINATOR = 1001  # of a frame rate: 30000/1001 and the like are exact
_TICKS = 90_000  # a second, at least: a unit of time in which a constant rate is exact, and any other time nearly


class VideoWriter:
    """What `write_video` hands out: takes RGB frames of one size.

    The codec wants even sides: the last column or row of an odd picture is cut off.
    """

    def __init__(self, path: Path, *, width: int, height: int, fps: float, bits_per_second: int | None = None) -> None:
        """path: of the video as it is to be in the end; it grows in `temporary`. bits_per_second: mean rate to keep to;
        None for a constant quality.

        Raises InputError where no encoder for H.264 is at hand, or the file cannot be written.
        """
        import av  # a tenth of a second, and libraries that only writers of videos need

        self.frames_written = 0
        self.temporary = temporary_path(path)
        self._path = path
        self._width, self._height = width, height
        self._even = (width - width % 2, height - height % 2)
        encoder = _encoder_name()
        if encoder is None:
            raise InputError(f"{path}: no video can be written here (PyAV has none of {', '.join(_ENCODERS)})")
        file = os.path.abspath(self.temporary)
        with _explained(path):
            self._container = av.open(file, "w", format="mp4", options={"movflags": "+faststart"})
        rate = Fraction(fps).limit_denominator(_MAX_DENOMINATOR)
        limits = {"maxrate": str(bits_per_second), "bufsize": str(bits_per_second)} if bits_per_second else {}
        options = dict(_SPEED.get(encoder, {})) | (limits or _QUALITY.get(encoder, {})) | _THREADS
        stream = self._container.add_stream(encoder, rate=rate, options=options)
        assert isinstance(stream, av.VideoStream)
        self._rate, self._last = rate, -1
        self._ticks = rate.numerator * -(-_TICKS // rate.numerator)
        stream.codec_context.time_base = Fraction(1, self._ticks)
        stream.width, stream.height = self._even
        stream.pix_fmt = "yuv420p"
        if bits_per_second:
            stream.bit_rate = bits_per_second
        self._stream = stream

    def write(self, image: UInt8[Tensor, "height width 3"], *, time_s: float | None = None) -> None:
        """Append one RGB frame of the size given at the start.

        time_s: when it is shown, later than the one before; a frame after that by the rate where none is given.
        """
        if tuple(image.shape[:2]) != (self._height, self._width):
            raise ValueError(
                f"video: expected frames of {self._width}x{self._height} px, got {image.shape[1]}x{image.shape[0]}"
            )
        import av

        width, height = self._even
        rgb = image[:height, :width].contiguous().cpu().numpy()
        # OpenCV takes a fifth of the time that FFmpeg takes for this.
        planes = np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2YUV_I420), np.uint8)
        frame = av.VideoFrame.from_ndarray(planes, format="yuv420p")
        step = round(self._ticks / self._rate) if self.frames_written else 1
        at = self._last + step if time_s is None else round(time_s * self._ticks)
        frame.pts, frame.time_base = max(at, self._last + 1), Fraction(1, self._ticks)
        self._last = frame.pts
        with _explained(self._path):
            self._container.mux(self._stream.encode(frame))
        self.frames_written += 1

    def close(self) -> None:
        """Write what the encoder still holds, and the index."""
        with _explained(self._path):
            if self.frames_written:
                self._container.mux(self._stream.encode(None))
            self._container.close()


@contextlib.contextmanager
def write_video(
    path: str | Path, *, width: int, height: int, fps: float = ASSUMED_FPS, bits_per_second: int | None = None
) -> Iterator[VideoWriter]:
    """`with write_video(...) as video: video.write(image)` leaves an MP4 file when the block ends well.

    bits_per_second: mean rate to keep to; None for a constant quality. When the block does not end well, or when not
    all frames have reached the disk (InputError), what was there before stays.
    """
    if min(width, height) < _SMALLEST_SIDE:
        raise ValueError(f"video: expected sides of at least {_SMALLEST_SIDE} px, got {width}x{height}")
    if not (math.isfinite(fps) and fps > 0):
        raise ValueError(f"video: expected a positive number of frames per second, got {fps}")
    path = Path(path)
    temporary = temporary_path(path)
    with explained_errors(path):
        temporary.touch()  # so that no encoder is begun where nothing can be written
    try:
        writer = VideoWriter(path, width=width, height=height, fps=fps, bits_per_second=bits_per_second)
        try:
            yield writer
        except BaseException:
            with contextlib.suppress(InputError):  # the first error is the one to report
                writer.close()
            raise
        writer.close()
        arrived = _count_frames(temporary)
        if arrived != writer.frames_written or arrived == 0:
            got = f"expected {writer.frames_written} frames, {arrived} arrived"
            raise DiskError(f"{path}: cannot be written ({got}; is the disk full?)")
        with explained_errors(path):
            os.replace(temporary, path)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise


@contextlib.contextmanager
def _explained(path: Path) -> Iterator[None]:
    """As `explained_errors`, for what FFmpeg says too."""
    from av.error import FFmpegError

    try:
        with explained_errors(path):
            yield
    except FFmpegError as error:
        raise DiskError(f"{path}: cannot be written ({error.strerror})") from error


def _encoder_name() -> str | None:
    """The first encoder for H.264 that PyAV has here; None without any."""
    from av.codec import Codec
    from av.codec.codec import UnknownCodecError

    for name in _ENCODERS:
        with contextlib.suppress(UnknownCodecError):
            return Codec(name, "w").name
    return None


def _count_frames(path: Path) -> int:
    """Frames that the index of a file tells of; 0 where it has none."""
    import av
    from av.error import FFmpegError

    try:
        with av.open(os.path.abspath(path)) as container:
            return container.streams.video[0].frames
    except (FFmpegError, IndexError):
        return 0
