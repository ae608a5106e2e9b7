"""Seeded sequences of a moving hand with exact truth."""

from torchhand.simulate.backgrounds import BACKGROUNDS, background_picture
from torchhand.simulate.motion import VIEWS, Motion, facing, hand_length, scripted_motion
from torchhand.simulate.people import sample_shape
from torchhand.simulate.scene import SKIN_TONES, RenderedFrame, SceneSettings, render_sequence
from torchhand.simulate.scripts import SCRIPTS

__all__ = [
    "BACKGROUNDS",
    "SCRIPTS",
    "SKIN_TONES",
    "VIEWS",
    "Motion",
    "RenderedFrame",
    "SceneSettings",
    "background_picture",
    "facing",
    "hand_length",
    "render_sequence",
    "sample_shape",
    "scripted_motion",
]
