"""Poses as a compact stream of bytes."""

from torchhand.export.stream.pose_stream import (
    PoseStreamReader,
    StreamFigures,
    StreamSettings,
    clip_of_stream,
    encode_clip,
    write_stream,
)

__all__ = [
    "PoseStreamReader",
    "StreamFigures",
    "StreamSettings",
    "clip_of_stream",
    "encode_clip",
    "write_stream",
]
