"""Opening what FFmpeg reads: a file, an address, standard input; nothing else is opened by what they hold."""

import os
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torchhand.errors import InputError
from torchhand.files.disk import check_name, check_plain_file
from torchhand.files.pictures.limits import largest_size, size_problem

if TYPE_CHECKING:
    from av import VideoStream
    from av.container import InputContainer

STANDARD_INPUT = "-"
ADDRESS = re.compile(r"^(https?|rtsps?|rtmps?|rtp|udp|tcp|srt)://", re.IGNORECASE)
"""Addresses of streams that are read."""
UNORDERED = "is no video that can be read in order (Matroska, MPEG-TS and MP4 with its index in front can)"
"""What is wrong with a video that comes through a pipe, or from a server that does not go back."""

_FORMATS = "mov,matroska,avi,mpeg,mpegts,mpegvideo,m4v,h264,hevc,asf,flv,ogg"
"""Containers of videos. A playlist, a list of files or a text that calls itself a video is none."""
_PIPED_FORMATS = f"{_FORMATS},nut,yuv4mpegpipe,mjpeg,mpjpeg,ivf,obu,av1"
_NETWORK = "http,https,httpproxy,tls,tcp,udp,rtp,rtsp,rtsps,rtmp,rtmps,srt,crypto,data"
_PATIENCE_S = 10.0
"""Silence after which an address has no more to say."""
_PASSWORD = re.compile(r"(?<=://)([^/@:]*):[^/@]*@")


def shown_address(place: str) -> str:
    """An address as messages and results tell it: without a password."""
    return _PASSWORD.sub(r"\1:***@", place)


def open_container(place: Path | str) -> tuple["InputContainer", "VideoStream"]:
    """Open a file, an address or standard input, and find the video in it.

    Pictures that are too large are refused by the header; no decoder takes them either (`max_pixels`).

    Raises InputError naming it and what is wrong.
    """
    from av.error import FFmpegError  # a tenth of a second

    what = shown_address(str(place)) if place != STANDARD_INPUT else "standard input"
    try:
        container = _opened(place)
    except (FFmpegError, OSError, ValueError) as error:
        raise InputError(f"{what}: {_reason(place, error)}") from error
    stream = next(iter(container.streams.video), None)
    if stream is None or stream.codec_context is None:
        container.close()
        raise InputError(f"{what}: is no video that can be opened (it holds none, or in a code that is not known)")
    context = stream.codec_context
    if problem := _size_problem(place, context.width, context.height):
        container.close()
        raise InputError(f"{what}: {problem}")
    context.options = {"max_pixels": str(largest_size())}
    context.thread_count = 1  # an error is then that of the packet that is being decoded; the callers have own threads
    return container, stream


def _size_problem(place: Path | str, width: int, height: int) -> str:
    """Why pictures of that size are not read; empty where they are, or where no size is told before one is decoded."""
    from av.error import FFmpegError

    if not width and not height and isinstance(place, Path):  # forgotten, because no decoder takes so large ones
        try:
            with _opened(place, {"skip_frame": "all"}) as container:
                context = container.streams.video[0].codec_context
                width, height = context.width, context.height
        except (FFmpegError, IndexError):
            return ""
    return size_problem(width, height) if width or height else ""


def _opened(place: Path | str, decoding: dict[str, str] | None = None) -> "InputContainer":
    """decoding: what decoders may not do while the container is looked at."""
    import av

    options = dict(decoding or {"max_pixels": str(largest_size())})
    if isinstance(place, Path):
        _check_file(place)
        options |= {"format_whitelist": _FORMATS, "protocol_whitelist": "file"}
        # An absolute path, because FFmpeg takes "a:b.mp4" for a protocol.
        return av.open(os.path.abspath(place), "r", options=options)
    if place == STANDARD_INPUT:
        options |= {"format_whitelist": _PIPED_FORMATS, "protocol_whitelist": "pipe"}
        source = sys.stdin.buffer
        return av.open(source if source.seekable() else _Pipe(source), "r", options=options)
    options |= {"protocol_whitelist": _NETWORK}
    return av.open(place, "r", options=options, timeout=_PATIENCE_S)


class _Pipe:
    """Bytes that come once and in order."""

    def __init__(self, source: Any) -> None:
        self._source = source

    def read(self, size: int) -> bytes:
        return self._source.read1(size)


def _check_file(path: Path) -> None:
    check_name(path)
    if not check_plain_file(path):
        raise InputError(f"{path}: is empty (0 bytes)")
    try:
        path.open("rb").close()  # the system says why it refuses, FFmpeg would not
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error


def reason_of(error: Exception) -> str:
    """What FFmpeg says of a failure, in words for a user."""
    from av.error import ExitError

    if isinstance(error, ExitError):  # FFmpeg was told to give up: "Immediate exit requested"
        return f"nothing came for {_PATIENCE_S:g} s"
    return getattr(error, "strerror", None) or str(error)


def _reason(place: Path | str, error: Exception) -> str:
    if isinstance(place, Path):
        return "is no video that can be opened (cut off, corrupt or of an unknown format)"
    if place == STANDARD_INPUT:
        return UNORDERED
    return f"cannot be read ({reason_of(error)})"
