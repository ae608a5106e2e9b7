"""The results of a tracking run: written frame by frame, resumed, read."""

from torchhand.files.results.checkpoint import ResumePoint
from torchhand.files.results.poses_file import (
    OVERLAYS_NAME,
    POSES_LINES_NAME,
    PictureRecord,
    PosesWriter,
)
from torchhand.files.results.results import (
    BACKWARD_NAME,
    CHECKPOINT_NAME,
    CONFIG_NAME,
    DETECTIONS_NAME,
    FORWARD_NAME,
    HAND_NAME,
    OVERLAY_NAME,
    TrackWriter,
    check_output_folder,
)
from torchhand.files.results.track_file import (
    FIT_NAME,
    JSONL_NAME,
    NPZ_NAME,
    POSES_NAME,
    UNFINISHED_NAME,
    load_track,
    write_npz,
)
from torchhand.files.results.track_record import (
    CONVENTION,
    DETERMINED,
    STATUSES,
    UNITS,
    FrameRecord,
    FrameStatus,
    Track,
    TrackHeader,
)

__all__ = [
    "BACKWARD_NAME",
    "CHECKPOINT_NAME",
    "CONFIG_NAME",
    "CONVENTION",
    "DETECTIONS_NAME",
    "DETERMINED",
    "FIT_NAME",
    "FORWARD_NAME",
    "HAND_NAME",
    "JSONL_NAME",
    "NPZ_NAME",
    "OVERLAYS_NAME",
    "OVERLAY_NAME",
    "POSES_LINES_NAME",
    "POSES_NAME",
    "STATUSES",
    "UNFINISHED_NAME",
    "UNITS",
    "FrameRecord",
    "FrameStatus",
    "PictureRecord",
    "PosesWriter",
    "ResumePoint",
    "Track",
    "TrackHeader",
    "TrackWriter",
    "check_output_folder",
    "load_track",
    "write_npz",
]
