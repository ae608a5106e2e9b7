"""The extended update on registered limb segments (Ouhaddi and Horain 1998)."""

from torchhand.track.extended.settings import ExtendedUpdateSettings
from torchhand.track.extended.update import ExtendedUpdate

__all__ = ["ExtendedUpdate", "ExtendedUpdateSettings"]
