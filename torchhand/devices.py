"""The device that work runs on, and the one place where work in progress asks it for a number.

An accelerator works through what was enqueued while the processor enqueues more. Whoever reads a tensor back waits
until all of that is done, and then the device waits for the processor. So iterations do not read: what a processor
leaves out because nothing is to be done (`may_hold`), an accelerator does for nothing, and whether a loop may end is
asked after several turns only (`asks_after`). On a processor numbers are there already, and what is done is left out at
once.
"""

from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from functools import lru_cache, wraps
from typing import Any, Generic, ParamSpec, Protocol, TypeVar, cast, overload, runtime_checkable

import numpy as np
import torch
from jaxtyping import Bool, Int, Shaped
from torch import Tensor

from torchhand.errors import InputError

TURNS = 8
"""Turns of a loop on an accelerator after which it asks whether it may end."""

MORE = 16
"""How many times as many problems an accelerator works on together as a processor."""

HOST = torch.device("cpu")
"""Where numpy and OpenCV work, and what is written to disks comes from."""

_HOSTS = ("cpu",)


@runtime_checkable
class _Moved(Protocol):
    """What tells itself how it comes to a device, such as a module with records in it."""

    def on(self, device: torch.device) -> Any: ...


_Record = TypeVar("_Record")
_Given = ParamSpec("_Given")
_Made = TypeVar("_Made")
_Work = TypeVar("_Work", bound=Callable[..., Any])


def is_host(device: torch.device) -> bool:
    """Whether the values of the device's tensors can be read without waiting: those in the processor's own memory."""
    return device.type in _HOSTS


def may_hold(flags: Bool[Tensor, "*any"]) -> bool:
    """Whether any of the flags may be set: on a processor whether one is, on an accelerator always."""
    return not is_host(flags.device) or bool(flags.any())


def asks_after(turn: int, device: torch.device) -> bool:
    """Whether a loop asks after this turn, from 0, if it may end: after every one on a processor, else after every
    `TURNS`."""
    return is_host(device) or turn % TURNS == TURNS - 1


def read_back(values: Shaped[Tensor, "*any"]) -> np.ndarray:
    """The values in the processor's memory, for which the device is waited for."""
    return values.detach().cpu().numpy()


def are_equal(one: Tensor, other: Tensor) -> bool:
    """Whether all values of two tensors are the same; waits for the device, once for what does not change."""
    return torch.equal(one, other)


def rows_where(flags: np.ndarray, device: torch.device) -> Int[Tensor, "some"]:
    """Numbers of the rows whose flag is set, on a device; the flags have been read back."""
    return torch.from_numpy(np.flatnonzero(flags)).to(device)


def kept(count: int) -> Callable[[Callable[_Given, _Made]], Callable[_Given, _Made]]:
    """Decorates a function of which as many results are kept, for callers in any of torch's modes; where torch
    compiles they are made anew: it knows nothing of caches."""

    def decorated(make: Callable[_Given, _Made]) -> Callable[_Given, _Made]:
        known = lru_cache(maxsize=count)(torch.inference_mode(False)(make))

        @wraps(known)
        def called(*args: _Given.args, **kwargs: _Given.kwargs) -> _Made:
            return (make if torch.compiler.is_compiling() else known)(*args, **kwargs)

        return called

    return decorated


@kept(512)
def constant_tensor(values: Any, dtype: torch.dtype, device: torch.device) -> Tensor:
    """Numbers in a tuple, or a tuple of tuples, as a tensor that was sent to the device once; not to be changed."""
    return torch.tensor(values, dtype=dtype, device=device)


class kept_property(Generic[_Made]):
    """A property that is made once for an object, and anew where torch compiles: `functools.cached_property`, whose
    lock (Python 3.11) no compiler takes."""

    def __init__(self, make: Callable[[Any], _Made]) -> None:
        self.make = make
        self.__doc__ = make.__doc__

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    @overload
    def __get__(self, instance: None, owner: type | None = None) -> "kept_property[_Made]": ...

    @overload
    def __get__(self, instance: object, owner: type | None = None) -> _Made: ...

    def __get__(self, instance: object | None, owner: type | None = None) -> "kept_property[_Made] | _Made":
        if instance is None:
            return self
        if torch.compiler.is_compiling():
            return self.make(instance)
        made = instance.__dict__[self.name] = self.make(instance)  # found before this from then on
        return made


def is_without_derivatives() -> bool:
    """Whether nobody can ask for the derivative of what is computed now; False where torch compiles."""
    if torch.compiler.is_compiling():
        return False
    return torch.is_inference_mode_enabled() and not torch._C._are_functorch_transforms_active()


def sent_to(record: _Record, device: torch.device) -> _Record:
    """A dataclass with its tensors on a device, those of the records in it too; itself where they are there.

    What is no record, such as a module, is sent by its own method `on`, where it has one.
    """
    return _sent(record, device)


def _sent(value: Any, device: torch.device) -> Any:
    if isinstance(value, Tensor):
        return value.to(device)
    if type(value) in (tuple, list):
        parts = type(value)(_sent(part, device) for part in value)
        return value if all(own is part for own, part in zip(parts, value, strict=True)) else parts
    if isinstance(value, _Moved):
        return value.on(device)
    if not is_dataclass(value) or isinstance(value, type):
        return value
    own = {field.name: getattr(value, field.name) for field in fields(value) if field.init}
    moved = {name: _sent(part, device) for name, part in own.items()}
    changed = {name: part for name, part in moved.items() if part is not own[name]}
    return replace(value, **changed) if changed else value


def finished(work: Callable[[], Any], device: torch.device) -> Callable[[], Any]:
    """Work that ends when the device has done it, for clocks; itself on a processor."""
    if device.type != "cuda":
        return work

    def done() -> Any:
        found = work()
        torch.cuda.synchronize(device)
        return found

    return done


def on_host(work: _Work) -> _Work:
    """The door to numpy and OpenCV: work whose arguments are sent to the processor, and whose result is sent to the
    device of the first one. On a processor nothing is sent."""

    @wraps(work)
    def done(first: Any, *others: Any, **named: Any) -> Any:
        device = first.device
        if is_host(device):
            return work(first, *others, **named)
        given = [sent_to(value, HOST) for value in (first, *others)]
        return sent_to(work(*given, **{name: sent_to(value, HOST) for name, value in named.items()}), device)

    return cast(_Work, done)


def at_once_on(device: torch.device, on_host: int) -> int:
    """How many problems to work on together where a processor takes `on_host`, as many as its caches hold: an
    accelerator needs as long for few as for many."""
    return on_host if is_host(device) else MORE * on_host


def device_named(name: str, *, option: str = "--device") -> torch.device:
    """The device of a name such as cpu, cuda or cuda:1. Raises InputError for one that is not there."""
    allowed = ["cpu", *_accelerators()]
    try:
        device = torch.device(name)
        if device.type in allowed and torch.zeros(1, device=device).numel() == 1:
            return device
    except RuntimeError:
        pass
    raise InputError(f"{option}: expected {' or '.join(allowed)} on this machine, got {name!r}")


def _accelerators() -> list[str]:
    return ["cuda"] if torch.cuda.is_available() else []
