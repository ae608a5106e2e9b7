"""A tracker's state as plain tensors, numbers and texts (torch.save with weights_only), and back."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import torch

from torchhand.devices import HOST, sent_to
from torchhand.fit import Appearance
from torchhand.fit.detect import CutAtKeypoints
from torchhand.hand import HandPose
from torchhand.image import ColourModel, Light, SkinModel
from torchhand.numerics import Gaussian
from torchhand.track.belief import FollowedHand
from torchhand.track.knowledge.state import Keyframe, ShapeFrame, TrackerState
from torchhand.track.scene import HandKeypoints, LearnedSkin, PackedMask, View

_RECORDS = {
    record.__name__: record
    for record in (
        TrackerState,
        Keyframe,
        ShapeFrame,
        PackedMask,
        View,
        HandKeypoints,
        FollowedHand,
        HandPose,
        Gaussian,
        Appearance,
        ColourModel,
        Light,
        LearnedSkin,
        CutAtKeypoints,
        SkinModel,
    )
}
_KIND = "record"


def saved_state(state: TrackerState) -> dict[str, Any]:
    """The state as plain data, from which `restored_state` goes on exactly."""
    return _plain(state)


def restored_state(saved: Mapping[str, Any], device: torch.device = HOST) -> TrackerState:
    """The inverse of `saved_state`, for a tracker on a device.

    Raises ValueError for content that is none: an unknown record, or one with other fields.
    """
    state = _record(saved)
    if not isinstance(state, TrackerState):
        raise ValueError(f"checkpoint: expected a TrackerState, got {type(state).__name__}")
    return sent_to(state, device)


def _plain(value: Any) -> Any:
    if is_dataclass(value) and not isinstance(value, type):
        return {_KIND: type(value).__name__} | {f.name: _plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, Gaussian):
        return {_KIND: "Gaussian", "mean": _plain(value.mean), "covariance": _plain(value.covariance)}
    if isinstance(value, torch.Tensor):
        return value.to(HOST, copy=True)
    if isinstance(value, tuple):
        return [_plain(one) for one in value]
    return value


def _record(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(_record(one) for one in value)
    if not isinstance(value, Mapping):
        return value
    kind = _RECORDS.get(value.get(_KIND, ""))
    if kind is None:
        raise ValueError(f"checkpoint: expected one of {', '.join(_RECORDS)}, got {value.get(_KIND)!r}")
    try:
        return kind(**{name: _record(content) for name, content in value.items() if name != _KIND})
    except TypeError as error:
        raise ValueError(f"checkpoint: {kind.__name__}: {error}") from error
