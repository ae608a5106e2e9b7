"""A guard against reading a device in the middle of work, and copies of records on other devices.

Runs on a processor: everything that would wait for an accelerator, or send it something, raises where it stands.
"""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

import torch
from torch import Tensor, nn
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode

import torchhand
from torchhand.hand import PoseConstraints

_PACKAGE = str(Path(torchhand.__file__).parent)
PERMITTED = {
    *(("devices.py", name) for name in ("read_back", "are_equal", "rows_where")),
    ("mesh_contours.py", "_depths"),
    ("edges.py", "_searched"),
}
"""The named places that may wait."""

_READS = {
    *(torch.Tensor.numpy, torch.Tensor.cpu, torch.Tensor.tolist, torch.Tensor.item, torch.Tensor.__array__),
    *(torch.Tensor.__bool__, torch.Tensor.__float__, torch.Tensor.__int__, torch.Tensor.__index__),
    *(torch.equal, torch.Tensor.equal, torch.allclose, torch.Tensor.allclose),
}
_WAITING = {
    *("_local_scalar_dense", "item", "is_nonzero", "equal", "allclose"),
    *("nonzero", "nonzero_numpy", "argwhere", "masked_select", "bincount"),
    *("_unique2", "unique_dim", "unique_consecutive", "_linalg_check_errors"),
    *("linalg_inv", "linalg_cholesky", "linalg_solve", "linalg_eigh", "linalg_svd", "linalg_lstsq"),
}
"""What tells the processor a number, a size that depends on numbers, or whether a matrix could be factored."""
_SENDING = {"lift_fresh"}
"""What makes a tensor of Python numbers, which are then sent."""
_INDEXING = {"index", "index_put", "index_put_", "_index_put_impl_"}


class HostRead(AssertionError):
    """Work in progress waited for its device, or sent it something."""


@dataclass
class Permitted:
    """How often the named places were used."""

    count: int = 0


def _place() -> tuple[str, bool]:
    """Where in the package the call comes from, and whether that is a named place."""
    place = ""
    frame: FrameType | None = sys._getframe(1)
    while frame is not None:
        code = frame.f_code
        if code.co_filename.startswith(_PACKAGE):
            name = code.co_filename.rpartition("/")[2]
            if (name, code.co_name) in PERMITTED:
                return name, True
            place = place or f"{name}:{frame.f_lineno} {code.co_name}"
        frame = frame.f_back
    return place, False


def _refuse(what: str, permitted: Permitted) -> None:
    place, is_permitted = _place()
    if not is_permitted:
        raise HostRead(f"{place}: {what}")
    permitted.count += what in ("numpy", "equal")


class _Functions(TorchFunctionMode):
    def __init__(self, permitted: Permitted) -> None:
        super().__init__()
        self.permitted = permitted

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        if func in _READS:
            _refuse(func.__name__, self.permitted)
        return func(*args, **(kwargs or {}))


class _Operations(TorchDispatchMode):
    def __init__(self, permitted: Permitted) -> None:
        super().__init__()
        self.permitted = permitted

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        name = func._schema.name.partition("::")[2]
        is_counted = (name == "repeat_interleave" and isinstance(args[-1], Tensor)) or (
            name == "where" and len(args) == 1
        )
        if name in _WAITING | _SENDING or is_counted:
            _refuse(str(func), self.permitted)
        if name in _INDEXING and any(x is not None and x.dtype in (torch.bool, torch.uint8) for x in args[1]):
            _refuse(f"{func} by a mask", self.permitted)
        return func(*args, **(kwargs or {}))


@contextmanager
def no_host_reads() -> Iterator[Permitted]:
    """Within the block a tensor that is read, or made of Python numbers, raises HostRead, but in a named place."""
    permitted = Permitted()
    with _Functions(permitted), _Operations(permitted):
        yield permitted


def on_device(value: Any, device: torch.device, known: dict[int, tuple[Any, Any]] | None = None) -> Any:
    """A record with all its tensors on a device.

    What is one object in the record stays one. Constraints of poses live in the processor's memory and stay there.
    """
    known = {} if known is None else known
    if id(value) in known:
        return known[id(value)][0]
    copied = value
    if isinstance(value, Tensor):
        copied = value.to(device)
    elif type(value) is tuple:
        copied = tuple(on_device(part, device, known) for part in value)
    elif type(value) is list:
        copied = [on_device(part, device, known) for part in value]
    elif type(value) is dict:
        copied = {key: on_device(part, device, known) for key, part in value.items()}
    elif isinstance(value, torch.device):
        copied = device
    elif isinstance(value, PoseConstraints) or not hasattr(value, "__dict__"):
        pass
    elif isinstance(value, nn.Module) or type(value).__module__.startswith("torchhand."):
        copied = object.__new__(type(value))
        known[id(value)] = (copied, value)
        for name, part in vars(value).items():
            object.__setattr__(copied, name, on_device(part, device, known))
    known[id(value)] = (copied, value)  # keeps the value, and with it its number
    return copied
