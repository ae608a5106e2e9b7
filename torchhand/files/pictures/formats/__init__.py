"""What the bytes of a picture's file tell before it is decoded, and what plain ones hold."""

from torchhand.files.pictures.formats.checked import CheckedPicture
from torchhand.files.pictures.formats.headers import declared_size
from torchhand.files.pictures.formats.jpeg import checked_jpeg
from torchhand.files.pictures.formats.png import checked_png

__all__ = ["CheckedPicture", "checked_jpeg", "checked_png", "declared_size"]
