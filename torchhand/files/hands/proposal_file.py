"""network.npz of models/proposals: the weights of the proposal network as 16-bit floats, its sizes and provenance."""

import json
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchhand.errors import InputError
from torchhand.files.disk import models_dir, opened_arrays, replacing
from torchhand.files.hands.hand_model import load_hand_model
from torchhand.hand import JOINT_DOFS
from torchhand.propose import SIDE_PX, ProposalNetwork

PROPOSAL_FORMAT = "torchhand proposals 1"
_HEADER = "header"
_COUNTERS = "num_batches_tracked"  # of batch normalisation; only training looks at them


def save_proposal_network(path: str | Path, network: ProposalNetwork, provenance: Mapping[str, Any]) -> None:
    """Write a network; the same network gives the same bytes. provenance: how it was trained, for people."""
    header = {
        "format": PROPOSAL_FORMAT,
        "sizes": network.sizes,
        "side_px": SIDE_PX,
        "joints": list(JOINT_DOFS),
        "provenance": dict(provenance),
    }
    arrays = {_HEADER: np.array(json.dumps(header))}
    for name, value in network.state_dict().items():
        if not name.endswith(_COUNTERS):
            kept = value.detach().cpu().numpy()
            arrays[name] = kept.astype(np.float32 if "running" in name else np.float16)
    with replacing(Path(path)) as temporary, temporary.open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]


@lru_cache(maxsize=4)
def load_proposal_network(path: str | Path | None = None) -> ProposalNetwork:
    """The network in a file, the shipped one where none is named; float32, for inference.

    Raises InputError naming the file and what is wrong with it.
    """
    path = models_dir() / "proposals" / "network.npz" if path is None else Path(path)
    with opened_arrays(path, complaint="is no proposal network that can be read") as stored:
        arrays = dict(stored)
    header = _header(path, arrays.pop(_HEADER, None))
    try:
        network = ProposalNetwork(load_hand_model().skeleton, **header["sizes"])
    except (TypeError, ValueError) as error:
        raise InputError(f"{path}: sizes: {error}") from error
    expected = {k: v for k, v in network.state_dict().items() if not k.endswith(_COUNTERS)}
    for name, value in expected.items():
        array = arrays.get(name)
        got = "nothing" if array is None else f"{array.dtype} {array.shape}"
        if array is None or array.dtype.kind != "f" or array.shape != tuple(value.shape):
            raise InputError(f"{path}: {name}: expected floating-point numbers {tuple(value.shape)}, got {got}")
        if not np.isfinite(array).all():
            raise InputError(f"{path}: {name}: expected finite numbers, got NaN or infinite ones")
    weights = {name: torch.from_numpy(arrays[name].astype(np.float32)) for name in expected}
    network.load_state_dict(weights, strict=False)
    return network.eval().requires_grad_(False)


def _header(path: Path, stored: np.ndarray | None) -> dict[str, Any]:
    try:
        header = json.loads(str(stored))
    except ValueError:
        header = None
    if not isinstance(header, dict) or header.get("format") != PROPOSAL_FORMAT:
        raise InputError(f"{path}: expected a proposal network ('format': '{PROPOSAL_FORMAT}'), got something else")
    for name, wanted in (("side_px", SIDE_PX), ("joints", list(JOINT_DOFS))):
        if header.get(name) != wanted:
            raise InputError(f"{path}: {name}: expected that of this version of torchhand, got another")
    if not isinstance(header.get("sizes"), dict):
        raise InputError(f"{path}: sizes: expected the sizes of the network, got {header.get('sizes')!r}")
    return header
