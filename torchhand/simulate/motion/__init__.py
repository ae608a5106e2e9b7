"""How simulated hands move: scripts, postures, recordings, and whose hands they are."""

from torchhand.simulate.motion.motion import (
    VIEWS,
    Motion,
    Staging,
    View,
    facing,
    filling_distance,
    hand_length,
    scripted_motion,
)
from torchhand.simulate.motion.population import sample_shape
from torchhand.simulate.motion.poses import parse_pose, posed_motion, sampled_motion
from torchhand.simulate.motion.recorded import (
    GLOVE_COLUMNS,
    GloveRecording,
    joints_of_glove,
    read_glove,
    recorded_motion,
)
from torchhand.simulate.motion.scripts import SCRIPTS

__all__ = [
    "GLOVE_COLUMNS",
    "SCRIPTS",
    "VIEWS",
    "GloveRecording",
    "Motion",
    "Staging",
    "View",
    "facing",
    "filling_distance",
    "hand_length",
    "joints_of_glove",
    "parse_pose",
    "posed_motion",
    "read_glove",
    "recorded_motion",
    "sample_shape",
    "sampled_motion",
    "scripted_motion",
]
