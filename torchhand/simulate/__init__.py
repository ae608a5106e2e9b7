"""Seeded sequences of a moving hand with exact truth."""

from torchhand.simulate.backgrounds import BACKGROUNDS, background_picture
from torchhand.simulate.motion import VIEWS, Motion, facing, hand_length, scripted_motion
from torchhand.simulate.people import sample_shape
from torchhand.simulate.recorded import GLOVE_COLUMNS, GloveRecording, joints_of_glove, read_glove, recorded_motion
from torchhand.simulate.scene import SKIN_TONES, RenderedFrame, SceneSettings, render_sequence
from torchhand.simulate.scripts import SCRIPTS
from torchhand.simulate.writer import check_sequence_folder, write_sequence

__all__ = [
    "BACKGROUNDS",
    "GLOVE_COLUMNS",
    "SCRIPTS",
    "SKIN_TONES",
    "VIEWS",
    "GloveRecording",
    "Motion",
    "RenderedFrame",
    "SceneSettings",
    "background_picture",
    "check_sequence_folder",
    "facing",
    "hand_length",
    "joints_of_glove",
    "read_glove",
    "recorded_motion",
    "render_sequence",
    "sample_shape",
    "scripted_motion",
    "write_sequence",
]
