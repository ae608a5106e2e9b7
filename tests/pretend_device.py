"""A device that is none: tensors say that they are on `meta`, and hold their numbers in the processor's memory.

Whatever would fail on an accelerator because tensors of two devices meet, or because numpy is given a tensor that it
cannot see, fails here too, on any machine; and what comes out is what the processor computes.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map

from torchhand import devices

NAME = "pretend"
torch.utils.backend_registration._setup_privateuseone_for_python_backend(NAME)
DEVICE = torch.device(NAME, 0)


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
                device=DEVICE,
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


def _called(func: Any, args: Any, kwargs: dict[str, Any]) -> Any:
    name = func._schema.name.partition("::")[2]
    given = [x for x in tree_leaves((args, kwargs)) if isinstance(x, Tensor)]
    ours = [x for x in given if isinstance(x, PretendTensor)]
    if any(x.device.type == NAME and not isinstance(x, PretendTensor) for x in given):
        raise RuntimeError(f"{func}: a tensor of the device that holds no numbers")
    device = kwargs.get("device")
    device = None if device is None else torch.device(device)
    moves = name in ("_to_copy", "copy_", "to") or (name == "lift_fresh")
    if ours and not moves and any(x.device.type == "cpu" and x.ndim for x in given):
        raise RuntimeError(f"{func}: expected all tensors on one device, got {[str(x.device) for x in given]}")
    if name == "to" and not isinstance(device, torch.device):
        tensors = [x for x in args[1:] if isinstance(x, Tensor)]
        named = [torch.device(x) for x in args[1:] if isinstance(x, str | torch.device)]
        device = tensors[0].device if tensors else (named[0] if named else None)
    is_ours = device.type == NAME if device is not None else bool(ours)
    if name == "copy_":
        is_ours = isinstance(args[0], PretendTensor)
    back = {id(x.held): x for x in ours}

    def inner(value: Any) -> Any:
        if isinstance(value, PretendTensor):
            return value.held
        return torch.device("cpu") if isinstance(value, torch.device) and value.type == NAME else value

    def outer(value: Any) -> Any:
        if not isinstance(value, Tensor) or not is_ours:
            return value
        return back[id(value)] if id(value) in back else PretendTensor(value)

    found = func(*tree_map(inner, args), **tree_map(inner, kwargs))
    if device is not None and not is_ours:  # to the processor: a copy, as from any device
        return tree_map(lambda x: x.clone() if isinstance(x, Tensor) and ours else x, found)
    if device is not None and not ours and name in ("_to_copy", "to"):  # a copy to the device
        found = tree_map(lambda x: x.clone() if isinstance(x, Tensor) else x, found)
    return tree_map(outer, found)


class _Pretence(TorchDispatchMode):
    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return _called(func, args, kwargs or {})


@contextmanager
def pretended() -> Iterator[torch.device]:
    """Within the block the device holds numbers; tensors of it live no longer than the block."""
    before = torch._C._only_lift_cpu_tensors()
    torch._C._set_only_lift_cpu_tensors(True)
    devices.constant_tensor.cache_clear()
    try:
        with _Pretence():
            yield DEVICE
    finally:
        torch._C._set_only_lift_cpu_tensors(before)
        devices.constant_tensor.cache_clear()
