"""Pictures of several cameras while they are taken."""

from torchhand.files.live.pairing import LivePictures, LiveSettings
from torchhand.files.live.rig import LiveCounts, LiveRig

__all__ = ["LiveCounts", "LivePictures", "LiveRig", "LiveSettings"]
