"""The state of a tracker on disk: with a checksum, and bound to the run that it belongs to."""

import hashlib
import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from torchhand.errors import InputError
from torchhand.files.disk import read_plain_file, replacing

_MAGIC = b"torchhand checkpoint 1\n"
_DIGEST = hashlib.sha256().digest_size
_LARGEST_BYTES = 1 << 30

State = Mapping[str, Any]
"""Tensors, numbers, texts, None, and lists and dicts of these: what `torch.load(weights_only=True)` takes."""


@dataclass(frozen=True, kw_only=True)
class ResumePoint:
    """Where an interrupted run goes on."""

    last_frame: int
    """Index of the last frame that is done; its line and all before stand in the file."""
    state: State
    """The tracker's state after that frame."""


def save_checkpoint(path: Path, point: ResumePoint, header: Mapping[str, Any]) -> None:
    """Write the state of a run with this header, or leave what was there and raise InputError."""
    packed = io.BytesIO()  # torch's writer hides why a disk refuses
    torch.save({"last_frame": point.last_frame, "state": dict(point.state)}, packed)
    content = _run_of(header) + packed.getvalue()
    with replacing(path) as temporary:
        temporary.write_bytes(_MAGIC + hashlib.sha256(content).digest() + content)


def load_checkpoint(path: Path, header: Mapping[str, Any]) -> tuple[ResumePoint | None, str]:
    """The state of a run with this header; None and the reason where the file holds none that is whole."""
    try:
        data = read_plain_file(path, largest=_LARGEST_BYTES)
    except InputError as error:
        return None, str(error)
    digest, content = data[len(_MAGIC) : len(_MAGIC) + _DIGEST], data[len(_MAGIC) + _DIGEST :]
    if not data.startswith(_MAGIC) or hashlib.sha256(content).digest() != digest:
        return None, f"{path}: is damaged, or no checkpoint of this version"
    if not content.startswith(_run_of(header)):
        return None, f"{path}: is the checkpoint of another run"
    try:
        saved = torch.load(io.BytesIO(content[_DIGEST:]), weights_only=True)
        last_frame, state = saved["last_frame"], saved["state"]
    except Exception as error:  # the reader raises whatever it stumbles over
        return None, f"{path}: cannot be read ({type(error).__name__})"
    if not isinstance(last_frame, int) or not isinstance(state, Mapping):
        return None, f"{path}: holds no state of a tracker"
    return ResumePoint(last_frame=last_frame, state=state), ""


def _run_of(header: Mapping[str, Any]) -> bytes:
    return hashlib.sha256(json.dumps(header, sort_keys=True).encode()).digest()
