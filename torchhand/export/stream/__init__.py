"""Poses as a compact stream of bytes."""

from torchhand.export.stream.channels import StreamSettings
from torchhand.export.stream.pose_stream import (
    PoseStreamReader,
    StreamFigures,
    clip_of_stream,
    encode_clip,
    write_stream,
)
from torchhand.export.stream.writer import PoseStreamWriter, StreamHead

__all__ = [
    "PoseStreamReader",
    "PoseStreamWriter",
    "StreamFigures",
    "StreamHead",
    "StreamSettings",
    "clip_of_stream",
    "encode_clip",
    "write_stream",
]
