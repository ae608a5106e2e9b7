"""Recordings of several cameras."""

from torchhand.files.rigs.rig import UNITS, load_rig, rig_notes, unit_in_metres
from torchhand.files.rigs.source import Offsets, RigFrame, RigSource, offsets_of, open_rig, open_uncalibrated
from torchhand.files.rigs.views import mask_paths

__all__ = [
    "UNITS",
    "Offsets",
    "RigFrame",
    "RigSource",
    "load_rig",
    "mask_paths",
    "offsets_of",
    "open_rig",
    "open_uncalibrated",
    "rig_notes",
    "unit_in_metres",
]
