"""What a tracker and the process that searches for it tell each other."""

import io
import pickle
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from torchhand.devices import HOST, is_host, sent_to
from torchhand.track.scene import View

READY = "ready"
"""Says that searches may begin."""


_AS_ARRAYS = (torch.uint8, torch.bool, torch.int16, torch.int32, torch.int64, torch.float32, torch.float64)


@dataclass(frozen=True, kw_only=True)
class SeenFrame:
    """The views of one time. By itself a message: follow a hand that was found to here."""

    time_s: float
    views: tuple[View, ...]
    """In the processor's memory."""

    @staticmethod
    def of(views: Sequence[View], time_s: float) -> "SeenFrame":
        return SeenFrame(time_s=time_s, views=tuple(sent_to(view, HOST) for view in views))

    @property
    def bytes(self) -> int:
        """Memory of the pictures."""
        pictures = (picture for view in self.views for picture in (view.image, view.mask) if picture is not None)
        return sum(picture.nbytes for picture in pictures)


@dataclass(frozen=True, kw_only=True)
class Search:
    """A frame in which other hands are to be looked for."""

    number: int
    frame: SeenFrame
    state: Mapping[str, Any] | None
    """What the tracker knew before the frame (`saved_state`); None at the first."""


@dataclass(frozen=True, kw_only=True)
class Reshape:
    """Frames of a hand that several cameras follow, to which its proportions are to be fitted."""

    number: int
    state: Mapping[str, Any]
    """What the tracker knew after the last of them (`saved_state`)."""


Request = Search | Reshape


@dataclass(frozen=True, kw_only=True)
class Answer:
    """How a request ended."""

    number: int
    """Number of the request."""
    seconds: float
    """Time that it took, without that of the way to the newest picture."""
    state: Mapping[str, Any] | None
    """Of a search, what is known of a hand that explains more, at the last frame there was; None where none does. Else
    the state with its new proportions."""


def packed(message: Any) -> bytes:
    """A message as bytes: tensors by their values, in no memory that processes share."""
    buffer = io.BytesIO()
    _Pickler(buffer, protocol=pickle.HIGHEST_PROTOCOL).dump(message)
    return buffer.getvalue()


class _Pickler(pickle.Pickler):
    """Tensors as arrays: a sixth of the time that torch takes for them."""

    def reducer_override(self, obj: Any) -> Any:
        """How an object is made again."""
        is_array = type(obj) is Tensor and is_host(obj.device) and not obj.requires_grad and obj.dtype in _AS_ARRAYS
        return (torch.from_numpy, (obj.numpy(),)) if is_array else NotImplemented
