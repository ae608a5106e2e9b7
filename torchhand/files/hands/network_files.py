"""network.npz and presence.npz of models/proposals: weights as 16-bit floats, sizes and provenance."""

import json
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from torch import nn

from torchhand.devices import HOST
from torchhand.errors import InputError
from torchhand.files.disk import models_dir, opened_arrays, replacing
from torchhand.files.hands.hand_model import load_hand_model
from torchhand.hand import JOINT_DOFS
from torchhand.propose import SIDE_PX, PresenceNetwork, ProposalNetwork

PROPOSAL_FORMAT = "torchhand proposals 1"
PRESENCE_FORMAT = "torchhand presence 1"
_FACTS: dict[str, dict[str, Any]] = {
    PROPOSAL_FORMAT: {"side_px": SIDE_PX, "joints": list(JOINT_DOFS)},
    PRESENCE_FORMAT: {"side_px": SIDE_PX},
}
"""What a network must have been trained for."""
_HEADER = "header"
_COUNTERS = "num_batches_tracked"  # of batch normalisation; only training looks at them

Network = TypeVar("Network", ProposalNetwork, PresenceNetwork)


def save_proposal_network(path: str | Path, network: ProposalNetwork, provenance: Mapping[str, Any]) -> None:
    """Write a network; the same network gives the same bytes. provenance: how it was trained, for people."""
    _save(Path(path), PROPOSAL_FORMAT, network, network.sizes, provenance)


def save_presence_network(path: str | Path, network: PresenceNetwork, provenance: Mapping[str, Any]) -> None:
    """Write a network; the same network gives the same bytes. provenance: how it was trained, for people."""
    _save(Path(path), PRESENCE_FORMAT, network, network.sizes, provenance)


@lru_cache(maxsize=4)
def load_proposal_network(path: str | Path | None = None, device: torch.device = HOST) -> ProposalNetwork:
    """The network in a file, the shipped one where none is named; float32, for inference on a device.

    Raises InputError naming the file and what is wrong with it.
    """
    path = models_dir() / "proposals" / "network.npz" if path is None else Path(path)
    skeleton = load_hand_model().skeleton
    return _load(path, PROPOSAL_FORMAT, "proposal network", lambda sizes: ProposalNetwork(skeleton, **sizes), device)


@lru_cache(maxsize=4)
def load_presence_network(path: str | Path | None = None, device: torch.device = HOST) -> PresenceNetwork:
    """The network in a file, the shipped one where none is named; float32, for inference on a device.

    Raises InputError naming the file and what is wrong with it.
    """
    path = models_dir() / "proposals" / "presence.npz" if path is None else Path(path)
    return _load(path, PRESENCE_FORMAT, "presence network", lambda sizes: PresenceNetwork(**sizes), device)


def _save(
    path: Path, file_format: str, network: nn.Module, sizes: Mapping[str, int], provenance: Mapping[str, Any]
) -> None:
    header = {"format": file_format, "sizes": sizes, **_FACTS[file_format], "provenance": dict(provenance)}
    arrays = {_HEADER: np.array(json.dumps(header))}
    for name, value in network.state_dict().items():
        if not name.endswith(_COUNTERS):
            kept = value.detach().cpu().numpy()
            arrays[name] = kept.astype(np.float32 if "running" in name else np.float16)
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]


@torch.inference_mode(False)  # kept for callers in any mode: weights made in one cannot be sent to a device in another
def _load(
    path: Path, file_format: str, what: str, make: Callable[[dict[str, int]], Network], device: torch.device
) -> Network:
    with opened_arrays(path, complaint=f"is no {what} that can be read") as stored:
        header = _header(path, stored.chosen([_HEADER]).get(_HEADER), file_format, what)
        try:
            network = make(header["sizes"])
        except (TypeError, ValueError, RuntimeError) as error:  # RuntimeError: torch, of a size without memory for it
            raise InputError(f"{path}: sizes: {error}") from error
        expected = {k: v for k, v in network.state_dict().items() if not k.endswith(_COUNTERS)}
        arrays = stored.chosen(expected)
    for name, value in expected.items():
        array = arrays.get(name)
        got = "nothing" if array is None else f"{array.dtype} {array.shape}"
        if array is None or array.dtype.kind != "f" or array.shape != tuple(value.shape):
            raise InputError(f"{path}: {name}: expected floating-point numbers {tuple(value.shape)}, got {got}")
        if not np.isfinite(array).all():
            raise InputError(f"{path}: {name}: expected finite numbers, got NaN or infinite ones")
    weights = {name: torch.from_numpy(arrays[name].astype(np.float32)) for name in expected}
    network.load_state_dict(weights, strict=False)
    # As convolutions read them, or they would be copied for each picture.
    network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    return network.to(device).eval().requires_grad_(False)


def _header(path: Path, stored: np.ndarray | None, file_format: str, what: str) -> dict[str, Any]:
    try:
        header = json.loads(str(stored))
    except ValueError:
        header = None
    if not isinstance(header, dict) or header.get("format") != file_format:
        raise InputError(f"{path}: expected a {what} ('format': '{file_format}'), got something else")
    for name, wanted in _FACTS[file_format].items():
        if header.get(name) != wanted:
            raise InputError(f"{path}: {name}: expected that of this version of torchhand, got another")
    if not isinstance(header.get("sizes"), dict):
        raise InputError(f"{path}: sizes: expected the sizes of the network, got {header.get('sizes')!r}")
    return header
