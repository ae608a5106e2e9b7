"""What a simulated picture shows besides truth: backgrounds, a forearm, light, faults of a mask."""

from torchhand.simulate.scene.backgrounds import BACKGROUNDS, BackgroundKind, background_picture
from torchhand.simulate.scene.forearm import cast_forearm
from torchhand.simulate.scene.mask_noise import noisy_mask
from torchhand.simulate.scene.scene import SKIN_TONES, RenderedFrame, SceneSettings, render_sequence

__all__ = [
    "BACKGROUNDS",
    "SKIN_TONES",
    "BackgroundKind",
    "RenderedFrame",
    "SceneSettings",
    "background_picture",
    "cast_forearm",
    "noisy_mask",
    "render_sequence",
]
