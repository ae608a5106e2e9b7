"""Named arrangements of cameras, and where they stand to a motion."""

from torchhand.simulate.rigs.rigs import FOV_DEG, SIZE_PX, named_rig
from torchhand.simulate.rigs.stage import stage_camera

__all__ = [
    "FOV_DEG",
    "SIZE_PX",
    "named_rig",
    "stage_camera",
]
