"""A run from the first frame to its results: what is asked for, recordings, checkpoints and overlays."""

from torchhand.runs.changes import changes_of
from torchhand.runs.overlays import overlay_frames
from torchhand.runs.recordings import LiveRecording, OneCameraRecording, RecordedFrame, Recording, RigRecording
from torchhand.runs.records import record_of, undetermined_fingers
from torchhand.runs.request import Request, keypoints_of, known_hand, settings_of, start_points_of
from torchhand.runs.run import Run, Say, header_of
from torchhand.runs.seen_hands import PALM_METRES, cameras_of_detections, same_frames, seen_keypoints
from torchhand.runs.short import fit_hand, track
from torchhand.runs.streams import STANDARD_OUTPUT, check_streams
from torchhand.runs.tracking import how_to_go_on, resume_option, summary_of, track_live_rig, track_rig, track_sequence
from torchhand.runs.videos import Video, VideoReport, track_videos, with_own_keypoints, without_hand

__all__ = [
    "PALM_METRES",
    "STANDARD_OUTPUT",
    "LiveRecording",
    "OneCameraRecording",
    "RecordedFrame",
    "Recording",
    "Request",
    "RigRecording",
    "Run",
    "Say",
    "Video",
    "VideoReport",
    "cameras_of_detections",
    "changes_of",
    "check_streams",
    "fit_hand",
    "header_of",
    "how_to_go_on",
    "keypoints_of",
    "known_hand",
    "overlay_frames",
    "record_of",
    "resume_option",
    "same_frames",
    "seen_keypoints",
    "settings_of",
    "start_points_of",
    "summary_of",
    "track",
    "track_live_rig",
    "track_rig",
    "track_sequence",
    "track_videos",
    "undetermined_fingers",
    "with_own_keypoints",
    "without_hand",
]
