"""The part of a picture that matters, cut out for speed: pixels beyond it cost nothing."""

from dataclasses import dataclass

import cv2
import numpy as np


@dataclass(frozen=True, kw_only=True)
class Window:
    """Columns left to right - 1 and rows top to bottom - 1 of a picture."""

    left: int
    top: int
    right: int
    bottom: int

    @classmethod
    def around(cls, marked: np.ndarray, margin: int, *, multiple: int = 1) -> "Window":
        """The box of what is marked (bool or uint8) and a margin, within the picture; all of it if nothing is.

        multiple: left and top are multiples of it, and right and bottom where the picture does not end.
        """
        height, width = marked.shape
        left, top, across, down = cv2.boundingRect(np.ascontiguousarray(marked).view(np.uint8))
        if not across:
            return cls(left=0, top=0, right=width, bottom=height)
        return cls(
            left=max(0, left - margin) // multiple * multiple,
            top=max(0, top - margin) // multiple * multiple,
            right=min(width, -(-(left + across + margin) // multiple) * multiple),
            bottom=min(height, -(-(top + down + margin) // multiple) * multiple),
        )

    @property
    def slices(self) -> tuple[slice, slice]:
        """Rows and columns, to index pictures with."""
        return slice(self.top, self.bottom), slice(self.left, self.right)
