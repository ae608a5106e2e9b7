"""What a simulated picture shows besides truth: backgrounds, a forearm, light, faults of a mask."""

from torchhand.simulate.scene.backgrounds import BACKGROUNDS, BackgroundKind, background_picture
from torchhand.simulate.scene.forearm import cast_forearm
from torchhand.simulate.scene.mask_noise import noisy_mask
from torchhand.simulate.scene.no_hand import NO_HAND, NoHandKind, picture_without_hand
from torchhand.simulate.scene.scene import SKIN_TONES, RenderedFrame, SceneSettings, SkinTone, render_sequence

__all__ = [
    "BACKGROUNDS",
    "NO_HAND",
    "SKIN_TONES",
    "BackgroundKind",
    "NoHandKind",
    "RenderedFrame",
    "SceneSettings",
    "SkinTone",
    "background_picture",
    "cast_forearm",
    "noisy_mask",
    "picture_without_hand",
    "render_sequence",
]
