"""Everything that touches a disk or a camera device: pictures in, calibrations, settings, results, hand models."""

from torchhand.files.cameras import camera_entry, camera_for, camera_of_entry, load_cameras, save_cameras
from torchhand.files.detection_record import Detections
from torchhand.files.detections import read_detections
from torchhand.files.frames import Frame, FrameSource, open_source, sequences_of
from torchhand.files.hand_file import FittedHand, load_hand, save_hand
from torchhand.files.hand_model import load_hand_model
from torchhand.files.hull_file import save_hull
from torchhand.files.locations import configs_dir, find_config, models_dir
from torchhand.files.mesh_file import load_mesh, save_mesh
from torchhand.files.pictures import read_picture
from torchhand.files.results import ResumePoint, TrackWriter, check_output_folder
from torchhand.files.rig import load_rig, rig_notes
from torchhand.files.rig_source import RigFrame, RigSource, offsets_of, open_rig
from torchhand.files.settings import load_settings, save_settings, setting_in
from torchhand.files.track_file import load_track
from torchhand.files.track_record import FrameRecord, FrameStatus, Track, TrackHeader
from torchhand.files.video_writer import VideoWriter, write_video

__all__ = [
    "Detections",
    "FittedHand",
    "Frame",
    "FrameRecord",
    "FrameSource",
    "FrameStatus",
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
    "save_hand",
    "save_hull",
    "save_mesh",
    "save_settings",
    "sequences_of",
    "setting_in",
    "write_video",
]
