"""torchhand: the open, anatomical, differentiable hand, and the trackers that fit it to video.

`Hand` makes the hand as a torch module, `Tracker` follows one. What is named here is the short way to the packages'
doors. Nothing is loaded before it is used, so that the command line answers at once.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import torch

    import torchhand.hand
    from torchhand.detect import HandDetector
    from torchhand.files import load_cameras, load_hand, load_hand_model, load_rig, load_track
    from torchhand.fit.keypoints import SeenKeypoints, fit_keypoints
    from torchhand.geometry import Camera, Rig, assumed_camera
    from torchhand.hand import HandPrior
    from torchhand.runs import fit_hand, settings_of, track
    from torchhand.runs.pictures import fit_pose
    from torchhand.track import Estimate, Tracker, TrackerSettings, TrackerState, View

__version__ = "0.1.0"

__all__ = [
    "Camera",
    "Estimate",
    "Hand",
    "HandDetector",
    "HandPrior",
    "Rig",
    "SeenKeypoints",
    "Tracker",
    "TrackerSettings",
    "TrackerState",
    "View",
    "__version__",
    "assumed_camera",
    "fit_hand",
    "fit_keypoints",
    "fit_pose",
    "load_cameras",
    "load_hand",
    "load_hand_model",
    "load_rig",
    "load_track",
    "settings_of",
    "track",
]

_DOORS = {
    "Camera": "torchhand.geometry",
    "Estimate": "torchhand.track",
    "HandDetector": "torchhand.detect",
    "HandPrior": "torchhand.hand",
    "Rig": "torchhand.geometry",
    "SeenKeypoints": "torchhand.fit.keypoints",
    "Tracker": "torchhand.track",
    "TrackerSettings": "torchhand.track",
    "TrackerState": "torchhand.track",
    "View": "torchhand.track",
    "assumed_camera": "torchhand.geometry",
    "fit_hand": "torchhand.runs",
    "fit_keypoints": "torchhand.fit.keypoints",
    "fit_pose": "torchhand.runs.pictures",
    "load_cameras": "torchhand.files",
    "load_hand": "torchhand.files",
    "load_hand_model": "torchhand.files",
    "load_rig": "torchhand.files",
    "load_track": "torchhand.files",
    "settings_of": "torchhand.runs",
}


def __getattr__(name: str) -> Any:
    """What a package's door exports, loaded at its first use."""
    if name == "track":  # a package, which may be called
        return importlib.import_module("torchhand.track")
    if name not in _DOORS:
        raise AttributeError(f"module 'torchhand' has no attribute {name!r}")
    return getattr(importlib.import_module(_DOORS[name]), name)


def __dir__() -> list[str]:
    """With the names that are not loaded yet, for those who complete them."""
    return sorted({*globals(), *__all__})


def Hand(
    shape: "torch.Tensor | None" = None,
    *,
    side: "torchhand.hand.Side" = "right",
    model: str = "generic_hand",
    dtype: "torch.dtype | None" = None,
) -> "torchhand.hand.Hand":
    """The hand of a shipped model, or of a model folder given by path, as a torch module: `Hand(shape)(pose)`.

    shape: parameters of the model's shape space, (52,) or (*batch, 52) for the generic hand; a tensor, an nn.Parameter
        to learn, or None for the default proportions. side: "right" or "left". dtype: torch.float32 where it is
        None, or torch.float64; the shape is converted to it. See `torchhand.hand.Hand`.

    Raises InputError for an unknown model, ValueError for a shape that is not finite or outside its bounds.
    """
    import torch

    from torchhand.files import load_hand_model

    return load_hand_model(model).hand(shape, side=side, dtype=dtype or torch.float32)
