"""What a program that finds hands in pictures is to us."""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from jaxtyping import UInt8
from torch import Tensor

from torchhand.files import HandDetection


@runtime_checkable
class Landmarks(Protocol):
    """Finds the hands of pictures that follow one another."""

    def detect(self, image: UInt8[Tensor, "height width 3"]) -> Sequence[HandDetection]:
        """All hands in the next picture (RGB): points in px with the first pixel's centre at (0, 0), in space in
        metres, and the side that each hand really has in a picture that is not mirrored. The same pictures in the same
        order give the same numbers bit for bit."""
        ...

    def close(self) -> None: ...


@runtime_checkable
class Landmarker(Protocol):
    """A program of which any number can be opened, one per sequence of pictures."""

    @property
    def name(self) -> str:
        """Program, version and model: the same name gives the same numbers."""
        ...

    def open(self, hands: int) -> Landmarks:
        """hands: how many are looked for at most."""
        ...
