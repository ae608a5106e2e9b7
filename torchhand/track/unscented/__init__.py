"""The unscented update on edges along contour normals (Stenger, Mendonça and Cipolla 2001)."""

from torchhand.track.unscented.settings import UnscentedUpdateSettings
from torchhand.track.unscented.update import UnscentedUpdate

__all__ = ["UnscentedUpdate", "UnscentedUpdateSettings"]
