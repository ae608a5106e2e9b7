"""A run from the first frame to its results: what is asked for, frame after frame, checkpoints and overlays."""

from torchhand.runs.changes import changes_of
from torchhand.runs.overlays import overlay_frames
from torchhand.runs.request import Request, known_hand, settings_of, start_points_of
from torchhand.runs.trackers import AnyTracker, tracker_of
from torchhand.runs.tracking import CHECKPOINT_EVERY, PROBLEMS_SHOWN, Say, how_to_go_on, summary_of, track_sequence

__all__ = [
    "CHECKPOINT_EVERY",
    "PROBLEMS_SHOWN",
    "AnyTracker",
    "Request",
    "Say",
    "changes_of",
    "how_to_go_on",
    "known_hand",
    "overlay_frames",
    "settings_of",
    "start_points_of",
    "summary_of",
    "track_sequence",
    "tracker_of",
]
