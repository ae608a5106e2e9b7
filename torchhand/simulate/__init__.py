"""Seeded sequences of a moving hand with exact truth."""

from torchhand.simulate.folder import check_sequence_folder
from torchhand.simulate.motion import (
    GLOVE_COLUMNS,
    SCRIPTS,
    VIEWS,
    GloveRecording,
    Motion,
    facing,
    hand_length,
    joints_of_glove,
    parse_pose,
    posed_motion,
    read_glove,
    recorded_motion,
    sample_shape,
    sampled_motion,
    scripted_motion,
)
from torchhand.simulate.rig_writer import RigRecord, render_rig, write_rig_sequence
from torchhand.simulate.rigs import named_rig, stage_camera
from torchhand.simulate.scene import (
    BACKGROUNDS,
    SKIN_TONES,
    RenderedFrame,
    SceneSettings,
    background_picture,
    noisy_mask,
    render_sequence,
)
from torchhand.simulate.writer import write_sequence

__all__ = [
    "BACKGROUNDS",
    "GLOVE_COLUMNS",
    "SCRIPTS",
    "SKIN_TONES",
    "VIEWS",
    "GloveRecording",
    "Motion",
    "RenderedFrame",
    "RigRecord",
    "SceneSettings",
    "background_picture",
    "check_sequence_folder",
    "facing",
    "hand_length",
    "joints_of_glove",
    "named_rig",
    "noisy_mask",
    "parse_pose",
    "posed_motion",
    "read_glove",
    "recorded_motion",
    "render_rig",
    "render_sequence",
    "sample_shape",
    "sampled_motion",
    "scripted_motion",
    "stage_camera",
    "write_rig_sequence",
    "write_sequence",
]
