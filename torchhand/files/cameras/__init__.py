"""Calibrations in our own format and in those of others."""

from torchhand.files.cameras.aniposelib import aniposelib_entries
from torchhand.files.cameras.cameras import (
    camera_entry,
    camera_for,
    camera_of_entry,
    load_cameras,
    only_camera,
    save_cameras,
)
from torchhand.files.cameras.colmap import colmap_entries
from torchhand.files.cameras.opencv import OPENCV_SUFFIXES, opencv_entries
from torchhand.files.cameras.per_picture import camera_per_picture
from torchhand.files.cameras.plain_text import lens_files, plain_text_entries

__all__ = [
    "OPENCV_SUFFIXES",
    "aniposelib_entries",
    "camera_entry",
    "camera_for",
    "camera_of_entry",
    "camera_per_picture",
    "colmap_entries",
    "lens_files",
    "load_cameras",
    "only_camera",
    "opencv_entries",
    "plain_text_entries",
    "save_cameras",
]
