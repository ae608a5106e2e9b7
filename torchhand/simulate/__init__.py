"""Seeded sequences of a moving hand with exact truth."""

from torchhand.simulate.backgrounds import BACKGROUNDS, background_picture
from torchhand.simulate.folder import check_sequence_folder
from torchhand.simulate.mask_noise import noisy_mask
from torchhand.simulate.motion import VIEWS, Motion, facing, hand_length, scripted_motion
from torchhand.simulate.people import sample_shape
from torchhand.simulate.poses import parse_pose, posed_motion, sampled_motion
from torchhand.simulate.recorded import GLOVE_COLUMNS, GloveRecording, joints_of_glove, read_glove, recorded_motion
from torchhand.simulate.rig_stage import stage_camera
from torchhand.simulate.rig_writer import RigRecord, render_rig, write_rig_sequence
from torchhand.simulate.rigs import named_rig
from torchhand.simulate.scene import SKIN_TONES, RenderedFrame, SceneSettings, render_sequence
from torchhand.simulate.scripts import SCRIPTS
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
