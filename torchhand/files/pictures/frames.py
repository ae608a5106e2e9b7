"""Where pictures come from: a video file, a folder of pictures or of videos, a webcam number, an address, a pipe."""

import re
from pathlib import Path
from urllib.parse import urlsplit

from torchhand.errors import InputError
from torchhand.files.disk import check_name, check_plain_file, expanded, short
from torchhand.files.pictures.container import ADDRESS, STANDARD_INPUT, shown_address
from torchhand.files.pictures.frame_source import FrameRange, FrameSource
from torchhand.files.pictures.pictures import PICTURE_SUFFIXES, PictureSource, natural_key, unique_names
from torchhand.files.pictures.video import VIDEO_SUFFIXES, VideoSource
from torchhand.files.pictures.webcam import WebcamSource

_MAX_DIGITS = 4  # of a webcam's number
_MAX_NAME = 256
_URL = re.compile(r"^[a-z][a-z0-9+.-]*:/", re.IGNORECASE)
_SUFFIXES = ", ".join(suffix[1:] for suffix in VIDEO_SUFFIXES + PICTURE_SUFFIXES)


def open_source(
    source: str | Path, *, start: int = 0, max_frames: int | None = None, already_done: int = 0
) -> FrameSource:
    """Open one sequence: a video file, a picture, a folder of pictures (natural order), a webcam number, the address of
    a stream, or `-` for a video on standard input; the last three are texts.

    Delivers frames start ... start + max_frames - 1 without the first `already_done` of them; after a resumed run none
    may remain, which is no error, whereas a `start` after the end is.

    Raises InputError naming the file and what was expected.
    """
    frames = FrameRange(start=start, max_frames=max_frames, already_done=already_done)
    number = _webcam_number(source)
    if number is not None:
        return WebcamSource(_webcam_name(number), number, frames)
    if (name := _stream_name(source)) is not None:
        return VideoSource(name, str(source), frames)
    path = _existing(source)
    if path.is_dir():
        pictures, videos = _content(path)
        if videos:
            raise InputError(f"{path}: expected a folder of pictures, got one with {len(videos)} videos: name one")
        return PictureSource(_name(path), pictures, frames)
    if path.suffix.lower() in PICTURE_SUFFIXES:
        return PictureSource(_name(path), [path], frames)
    if path.suffix.lower() not in VIDEO_SUFFIXES:  # FFmpeg would take a text for a film of a terminal
        raise InputError(f"{path}: expected a video or a picture ({_SUFFIXES}), got {path.suffix or 'no suffix'}")
    return VideoSource(_name(path), path, frames)


def sequences_of(source: str | Path) -> list[tuple[str, str | Path]]:
    """Names and inputs for `open_source`: one per video of a folder of videos, otherwise the one that was given.

    An input is a text where it can be read only once: a webcam, an address, standard input.

    Names are unique and fit for folders. Nothing is opened yet; missing files and useless folders raise InputError.
    """
    number = _webcam_number(source)
    if number is not None:
        return [(_webcam_name(number), str(number))]
    if (name := _stream_name(source)) is not None:
        return [(name, str(source))]
    path = _existing(source)
    if not path.is_dir():
        return [(_name(path), path)]
    _, videos = _content(path)
    if not videos:
        return [(_name(path), path)]
    return list(zip(unique_names(videos), videos, strict=True))


def is_webcam(source: str | Path) -> bool:
    """Whether `open_source` takes this for the number of a webcam."""
    return _webcam_number(source) is not None


def is_stream(source: str | Path) -> bool:
    """Whether `open_source` takes this for an address or standard input."""
    return _stream_name(source) is not None


def _webcam_number(source: str | Path) -> int | None:
    """Digits alone are a webcam, unless a file or folder has that very name."""
    text = str(source)
    if not (text.isascii() and text.isdigit()) or (len(text) < _MAX_NAME and Path(text).exists()):
        return None
    if len(text) > _MAX_DIGITS:
        raise InputError(f"{short(text)}: expected a webcam number of at most {_MAX_DIGITS} digits")
    return int(text)


def _stream_name(source: str | Path) -> str | None:
    """Of an address or of standard input, fit for a folder; None for anything else."""
    if source == STANDARD_INPUT:
        return "stdin"
    if not isinstance(source, str) or not ADDRESS.match(source):
        return None
    try:
        host = urlsplit(source).hostname or ""
    except ValueError:
        raise InputError(f"{shown_address(source)}: is no address") from None
    return "".join(letter if letter.isalnum() else "_" for letter in host) or "stream"


def _webcam_name(number: int) -> str:
    return f"webcam{number}"


def _name(path: Path) -> str:
    whole = path.resolve()
    return (whole.name if path.is_dir() else whole.stem) or "root"


def _existing(source: str | Path) -> Path:
    if not str(source):
        raise InputError("expected a video, a folder or a webcam number, got an empty name")
    path = expanded(source)
    check_name(path)
    try:
        path.stat()
    except FileNotFoundError:
        if _URL.match(str(source)):
            expected = "http, https, rtsp, rtmp, rtp, udp, tcp or srt://HOST/..."
            raise InputError(f"{source}: expected an address such as {expected}, given as a text") from None
        raise InputError(f"{path}: no such file or folder (expected a video, a folder or a webcam number)") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from error
    if not path.is_dir():
        check_plain_file(path)
    return path


def _content(folder: Path) -> tuple[list[Path], list[Path]]:
    """Pictures and videos of a folder in natural order: one of the lists is empty, the other is not."""
    try:
        entries = sorted((p for p in folder.iterdir() if not p.name.startswith(".")), key=natural_key)
    except OSError as error:
        raise InputError(f"{folder}: cannot be read ({error.strerror or error})") from error
    pictures = [p for p in entries if p.suffix.lower() in PICTURE_SUFFIXES and p.is_file()]
    videos = [p for p in entries if p.suffix.lower() in VIDEO_SUFFIXES and p.is_file()]
    for entry in (*pictures, *videos):
        check_name(entry)
    if pictures and videos:
        raise InputError(f"{folder}: expected pictures or videos, got both ({pictures[0].name}, {videos[0].name}, ...)")
    if pictures or videos:
        return pictures, videos
    if not entries:
        raise InputError(f"{folder}: is an empty folder")
    inner = [p.name for p in entries if p.is_dir()]
    hint = f"; it has the folders {', '.join(inner[:5])}: give one of them" if inner else ""
    raise InputError(f"{folder}: holds no pictures and no videos ({_SUFFIXES}){hint}")
