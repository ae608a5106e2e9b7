"""What a look at the bytes of a whole picture's file tells."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8


@dataclass(frozen=True, kw_only=True)
class CheckedPicture:
    """Whether a file is whole, and the picture where the look gives it."""

    whole: bytes | None
    """The bytes to decode; None where they are cut off or damaged."""
    pixels: UInt8[np.ndarray, "height width *rgb"] | None = None
    """The picture, grey or RGB; None where another decoder has to make it: one that knows how the camera was held, or
    rarer kinds."""
    problem: str = ""
    """What is wrong with the file; empty where it is whole."""
