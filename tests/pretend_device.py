"""A device that is none: tensors say that they are on `meta`, and hold their numbers in the processor's memory.

Whatever would fail on an accelerator because tensors of two devices meet, or because numpy is given a tensor that it
cannot see, fails here too, on any machine; and what comes out is what the processor computes.
"""

import inspect
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from torchhand import devices

NAME = "pretend"
WHY_NOT: str | None = None
"""Why there can be no such device here."""
if torch.cuda.is_available():  # gradients of the other device are no longer computed once one is added
    WHY_NOT = "torch knows one accelerator at a time, and there is a real one: pytest -m gpu"
else:
    try:
        from torch.utils.backend_registration import _setup_privateuseone_for_python_backend
    except ImportError:
        WHY_NOT = f"torch {torch.__version__} knows no devices that are added in Python"
    else:
        _setup_privateuseone_for_python_backend(NAME)
CPU = torch.device("cpu")
_MOVING = {"_to_copy", "copy_", "to", "lift_fresh"}
_INDEXING = {"index", "index_put", "index_put_", "_index_put_impl_"}


_sent = 0


def sent() -> int:
    """How many tensors have been sent from the processor's memory to the device so far."""
    return _sent


class PretendTensor(Tensor):
    """A tensor on the device, around one in the processor's memory."""

    held: Tensor

    @staticmethod
    def __new__(cls, held: Tensor) -> "PretendTensor":
        with torch.inference_mode(False):  # views of tensors of either kind
            made = Tensor._make_wrapper_subclass(
                cls,
                held.shape,
                strides=held.stride(),
                storage_offset=held.storage_offset(),
                dtype=held.dtype,
                device=torch.device(NAME, 0),
                requires_grad=held.requires_grad,
            )
        made.held = held
        return made

    def __repr__(self, *, tensor_contents: Any = None) -> str:
        return f"Pretend({self.held})"

    def tolist(self) -> Any:
        """As of any device's tensor; torch refuses it to subclasses."""
        return self.held.tolist()

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return _called(func, args, kwargs or {})


@lru_cache(maxsize=4096)
def _kind(func: Any) -> tuple[str, bool]:
    """Name of an operation, and whether it changes the size of what it is given."""
    return func._schema.name.partition("::")[2], torch.Tag.inplace_view in func.tags


def _mapped(value: Any, change: Any) -> Any:
    if isinstance(value, list | tuple):
        return type(value)([_mapped(part, change) for part in value]) if value else value
    return change(value)


def _held(value: Any) -> Any:
    if isinstance(value, PretendTensor):
        return value.held
    return CPU if isinstance(value, torch.device) and value.type == NAME else value


def _called(func: Any, args: Any, kwargs: dict[str, Any]) -> Any:
    """The operation on what is held; its result is on the device if what it is made of is, or if that is asked for."""
    name, changes_size = _kind(func)
    ours: dict[int, PretendTensor] = {}
    others = 0

    def look(value: Any) -> Any:
        nonlocal others
        if isinstance(value, PretendTensor):
            ours[id(value.held)] = value
        elif isinstance(value, Tensor):
            others += value.ndim > 0
        return _held(value)

    own_args = [_mapped(value, look) for value in args]
    own_kwargs = {key: _mapped(value, look) for key, value in kwargs.items()}
    device = _asked_for(name, args, kwargs)
    # As on CUDA: places may be told by a tensor in the processor's memory.
    is_told = name in _INDEXING and isinstance(args[0], PretendTensor)
    if ours and others and not is_told and name not in _MOVING:
        raise RuntimeError(f"{func}: expected all tensors on one device, got some of {NAME} and others of {CPU}")
    is_ours = bool(ours) if device is None else device.type == NAME
    if name == "copy_":
        is_ours = isinstance(args[0], PretendTensor)
    found = func(*own_args, **own_kwargs)
    if changes_size and isinstance(args[0], PretendTensor):  # its own size is to follow
        with torch._C._DisableTorchDispatch():
            return func(*args, **kwargs)
    if not is_ours:
        is_read = device is not None and ours and isinstance(found, Tensor)
        return found.clone() if is_read else found
    if others and not is_told:
        global _sent
        _sent += 1
        found = found.clone() if not ours and isinstance(found, Tensor) else found

    def wrapped(value: Any) -> Any:
        return (
            ours.get(id(value)) if id(value) in ours else PretendTensor(value) if isinstance(value, Tensor) else value
        )

    return _mapped(found, wrapped)


def _asked_for(name: str, args: Any, kwargs: dict[str, Any]) -> torch.device | None:
    """The device that an operation names, if any."""
    if (named := kwargs.get("device")) is not None:
        return torch.device(named)
    for value in args[1:] if name == "to" else ():
        if isinstance(value, Tensor):
            return value.device
        if isinstance(value, str | torch.device):
            return torch.device(value)
    return None


class _Pretence(TorchDispatchMode):
    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return _called(func, args, kwargs or {})


def _forget_constants() -> None:
    known: Any = inspect.getattr_static(devices.constant_tensor, "__wrapped__")
    known.cache_clear()


@contextmanager
def pretended() -> Iterator[torch.device]:
    """Within the block the device holds numbers; tensors of it live no longer than the block."""
    before = torch._C._only_lift_cpu_tensors()
    torch._C._set_only_lift_cpu_tensors(True)
    _forget_constants()
    try:
        with _Pretence():
            yield torch.device(NAME, 0)
    finally:
        torch._C._set_only_lift_cpu_tensors(before)
        _forget_constants()
