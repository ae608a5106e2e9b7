"""Everything that touches a disk or a camera device: pictures in, calibrations, settings, results, hand models."""

from torchhand.files.cameras import (
    camera_entry,
    camera_for,
    camera_of_entry,
    camera_per_picture,
    load_cameras,
    save_cameras,
)
from torchhand.files.detections import DetectionLog, Detections, HandDetection, read_detections, save_detections
from torchhand.files.disk import configs_dir, find_config, models_dir
from torchhand.files.hands import FittedHand, load_hand, load_hand_model, load_mesh, save_hand, save_mesh
from torchhand.files.hull_file import save_hull
from torchhand.files.pictures import (
    Frame,
    FrameSource,
    VideoWriter,
    open_source,
    read_picture,
    sequences_of,
    write_video,
)
from torchhand.files.results import (
    FrameRecord,
    FrameStatus,
    ResumePoint,
    Track,
    TrackHeader,
    TrackWriter,
    check_output_folder,
    load_track,
)
from torchhand.files.rigs import RigFrame, RigSource, load_rig, offsets_of, open_rig, rig_notes
from torchhand.files.settings import load_settings, save_settings, setting_in

__all__ = [
    "DetectionLog",
    "Detections",
    "FittedHand",
    "Frame",
    "FrameRecord",
    "FrameSource",
    "FrameStatus",
    "HandDetection",
    "ResumePoint",
    "RigFrame",
    "RigSource",
    "Track",
    "TrackHeader",
    "TrackWriter",
    "VideoWriter",
    "camera_entry",
    "camera_for",
    "camera_of_entry",
    "camera_per_picture",
    "check_output_folder",
    "configs_dir",
    "find_config",
    "load_cameras",
    "load_hand",
    "load_hand_model",
    "load_mesh",
    "load_rig",
    "load_settings",
    "load_track",
    "models_dir",
    "offsets_of",
    "open_rig",
    "open_source",
    "read_detections",
    "read_picture",
    "rig_notes",
    "save_cameras",
    "save_detections",
    "save_hand",
    "save_hull",
    "save_mesh",
    "save_settings",
    "sequences_of",
    "setting_in",
    "write_video",
]
