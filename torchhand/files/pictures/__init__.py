"""Pictures, folders of pictures, videos and webcams in, videos out."""

from torchhand.files.pictures.container import shown_address
from torchhand.files.pictures.frame_source import ASSUMED_FPS, Frame, FrameRange, FrameSource
from torchhand.files.pictures.frames import is_stream, is_webcam, open_source, sequences_of
from torchhand.files.pictures.identity import file_identity, input_identity
from torchhand.files.pictures.limits import MAX_MEGAPIXELS, pixel_limit, size_problem
from torchhand.files.pictures.pictures import (
    PICTURE_SUFFIXES,
    PictureSource,
    named_picture,
    natural_key,
    read_picture,
    unique_names,
)
from torchhand.files.pictures.video import VIDEO_SUFFIXES, video_times
from torchhand.files.pictures.video_writer import VideoWriter, write_video

__all__ = [
    "ASSUMED_FPS",
    "MAX_MEGAPIXELS",
    "PICTURE_SUFFIXES",
    "VIDEO_SUFFIXES",
    "Frame",
    "FrameRange",
    "FrameSource",
    "PictureSource",
    "VideoWriter",
    "file_identity",
    "input_identity",
    "is_stream",
    "is_webcam",
    "named_picture",
    "natural_key",
    "open_source",
    "pixel_limit",
    "read_picture",
    "sequences_of",
    "shown_address",
    "size_problem",
    "unique_names",
    "video_times",
    "write_video",
]
