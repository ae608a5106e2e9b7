"""The overlay video as a page embeds it: as it is where it is small enough, else encoded anew."""

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import torch
from tqdm import tqdm

from torchhand.files import open_source, write_video
from torchhand.files.disk import temporary_path

MAX_BYTES = 24 * 1024 * 1024
"""Of the video inside a page; a page of 10 minutes stays below 40 MB in all."""
_SPARE = 0.85  # share of the bytes that the encoder is asked to fill
_BITS_PER_PIXEL = 0.04  # below which a smaller picture looks better
_SMALLEST_SIDE = 64  # px


@contextlib.contextmanager
def small_video(overlay: Path, page: Path, *, max_bytes: int = MAX_BYTES) -> Iterator[tuple[Path, str]]:
    """The file to embed, and a note on how it differs from the overlay. page: beside which one that is encoded anew
    lives until the block ends."""
    size = overlay.stat().st_size
    if size <= max_bytes:
        yield overlay, ""
        return
    small = temporary_path(page.with_suffix(".mp4"))
    try:
        note = _encode(overlay, small, max_bytes)
        yield small, note
    finally:
        with contextlib.suppress(OSError):
            small.unlink(missing_ok=True)


def _encode(overlay: Path, small: Path, max_bytes: int) -> str:
    with open_source(overlay) as frames:
        count = frames.count or 1
        rate = max(1, int(8 * _SPARE * max_bytes * frames.fps / count))
        wanted = rate / (_BITS_PER_PIXEL * frames.fps * frames.width * frames.height)
        scale = min(1.0, wanted**0.5)
        width, height = (max(_SMALLEST_SIDE, 2 * round(0.5 * scale * side)) for side in (frames.width, frames.height))
        with (
            write_video(small, width=width, height=height, fps=frames.fps, bits_per_second=rate) as video,
            tqdm(total=count, desc="report", unit="frame", disable=not sys.stderr.isatty()) as bar,
        ):
            for frame in frames:
                if frame.image is None:
                    continue
                picture = cv2.resize(frame.image.numpy(), (width, height), interpolation=cv2.INTER_AREA)
                video.write(torch.from_numpy(picture), time_s=frame.time_s)
                bar.update()
    return (
        f"encoded anew at {width}×{height} px and some {rate / 1000:.0f} kbit/s, so that this page stays small;"
        f" {overlay.name} beside it has the full quality"
    )
