"""What numbers a call is computed in: those of its tensors, whatever `torch.autocast` asks for.

A hand in bfloat16 is wrong by millimetres, and a filter's covariance in it is none. So autocast reaches neither hands
nor filters nor solvers; half precision is for a hand that was asked for in it. Tensors of one call, and those within
records of them, have one dtype.
"""

import inspect
from collections.abc import Callable, Iterable
from dataclasses import fields
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import torch
from torch import Tensor
from torch._subclasses import FakeTensor
from torch.utils import _pytree

P = ParamSpec("P")
R = TypeVar("R")
Record = TypeVar("Record", bound=type)

EXACT = (torch.float32, torch.float64)
"""Dtypes that filters, solvers and priors compute in."""
_DEVICES = ("cpu", "cuda", "mps", "xpu")
_RECORDS: dict[type, str] = {}
"""Records that are known, each with the field that tells its dtype."""


def own_precision(function: Callable[P, R]) -> Callable[P, R]:
    """The function with every product in the dtype of its tensors, also within `torch.autocast`.

    Tensors of half precision that autocast has made on the way here are promoted to float32, as torch does it for
    functions that need that. Tensors of different floating-point dtypes are refused: ValueError with one line that
    names both. A record counts as the tensors that it holds where `record` made it known; others, such as cameras and
    limits, are constants that follow the tensors.
    """
    return _guarded(function, is_exact=False)


def full_precision(function: Callable[P, R]) -> Callable[P, R]:
    """As `own_precision`, and half precision is refused as well where autocast did not make it."""
    return _guarded(function, is_exact=True)


def without_autocast(function: Callable[P, R]) -> Callable[P, R]:
    """The function out of the reach of `torch.autocast`; it converts what is measured to its own dtype itself."""

    @wraps(function)
    def called(*args: P.args, **kwargs: P.kwargs) -> R:
        if torch._C._is_any_autocast_enabled():
            return _switched_off(called, args, kwargs)
        return function(*args, **kwargs)

    return called


def _guarded(function: Callable[P, R], *, is_exact: bool) -> Callable[P, R]:
    names = tuple(inspect.signature(function).parameters)

    @wraps(function)
    def called(*args: P.args, **kwargs: P.kwargs) -> R:
        if torch._C._is_any_autocast_enabled():
            return _switched_off(called, args, kwargs)
        kept = None
        for value in (*args, *kwargs.values()) if kwargs else args:
            if isinstance(value, Tensor):
                dtype = value.dtype
            elif type(value) in _RECORDS:
                dtype = _dtype_of(value)
            else:
                continue
            if dtype is kept or dtype is None or not dtype.is_floating_point:
                continue
            if kept is not None or (is_exact and dtype not in EXACT):
                raise _refusal(names, args, kwargs)
            kept = dtype
        return function(*args, **kwargs)

    return called


def _switched_off(function: Callable[..., R], args: tuple[Any, ...], kwargs: dict[str, Any]) -> R:
    """Switch autocast off for one kind of device after the other, and promote what it made."""
    for device in _DEVICES:
        if torch.is_autocast_enabled(device):
            args = tuple(_promoted(value) for value in args)
            kwargs = {name: _promoted(value) for name, value in kwargs.items()}
            with torch.autocast(device, enabled=False):
                return function(*args, **kwargs)
    raise RuntimeError(f"autocast: expected one for {', '.join(_DEVICES)}, which alone can be switched off here")


def _promoted(value: Any) -> Any:
    is_half = isinstance(value, Tensor) and value.dtype in (torch.bfloat16, torch.float16)
    return value.float() if is_half else value


def _dtype_of(value: Any) -> torch.dtype | None:
    """The dtype of a record's first field; None for what is neither a tensor nor a known record."""
    while (name := _RECORDS.get(type(value))) is not None:
        value = getattr(value, name)
    return value.dtype if isinstance(value, Tensor) else None


def _refusal(names: tuple[str, ...], args: tuple[Any, ...], kwargs: dict[str, Any]) -> ValueError:
    """What is wrong with the dtypes of these arguments."""
    given = [
        (type(value).__name__ if name == "self" else name, _dtype_of(value))
        for name, value in (*zip(names, args, strict=False), *kwargs.items())
    ]
    numbers = [(name, dtype) for name, dtype in given if dtype is not None and dtype.is_floating_point]
    first, kept = numbers[0]
    for name, dtype in numbers:
        if dtype is not kept:
            return ValueError(f"{name}: expected {kept}, that of {first}, got {dtype}")
    return ValueError(f"{first}: expected torch.float32 or torch.float64, got {kept}")


def require_exact(name: str, dtype: torch.dtype | None) -> None:
    """Raise ValueError, one line, for a dtype that filters, solvers and priors do not compute in; None is no dtype."""
    if dtype is not None and dtype not in EXACT:
        raise ValueError(f"{name}: expected torch.float32 or torch.float64, got {dtype}")


def record(*constants: str) -> Callable[[Record], Record]:
    """Make a frozen dataclass of tensors known to torch: `torch.vmap` and `torch.func` take and give such records.

    constants: fields that belong to the record as a whole, such as the faces of a mesh: no dimension is mapped over
    them and no derivative is taken of them. They are the same where they are the same object.
    """

    def registered(kind: Record) -> Record:
        every = tuple(field.name for field in fields(kind))

        def flatten(value: object) -> tuple[list[object], _Constants]:
            # An exported program is called with other tensors than those that it was traced with.
            kept = tuple(name for name in constants if not isinstance(getattr(value, name), FakeTensor))
            names = tuple(name for name in every if name not in kept)
            return [getattr(value, name) for name in names], _Constants(
                names, {name: getattr(value, name) for name in kept}
            )

        def flatten_with_keys(value: object) -> tuple[list[tuple[Any, object]], _Constants]:
            parts, kept = flatten(value)
            return [(_pytree.GetAttrKey(name), part) for name, part in zip(kept.names, parts, strict=True)], kept

        def unflatten(parts: Iterable[object], kept: Any) -> object:
            new = object.__new__(kind)  # without the checks of the constructor: leaves need be no tensors
            for name, part in (*zip(kept.names, parts, strict=True), *kept.values.items()):
                object.__setattr__(new, name, part)
            return new

        _pytree.register_pytree_node(
            kind,
            flatten,
            unflatten,
            serialized_type_name=f"{kind.__module__}.{kind.__qualname__}",
            flatten_with_keys_fn=flatten_with_keys,
        )
        _RECORDS[kind] = next(name for name in every if name not in constants)
        return kind

    return registered


class _Constants:
    """Names of a record's leaves, and what it holds besides; equal where the names are and the rest is the same."""

    def __init__(self, names: tuple[str, ...], values: dict[str, object]) -> None:
        self.names, self.values = names, values

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, _Constants) or self.names != other.names:
            return False
        return all(value is other.values[name] for name, value in self.values.items())

    def __hash__(self) -> int:
        return hash((self.names, *map(id, self.values.values())))
