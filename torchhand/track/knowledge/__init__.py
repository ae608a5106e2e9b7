"""What a tracker knows between two frames, what it says of one, and both as plain tensors."""

from torchhand.track.knowledge.checkpoint import restored_state, saved_state
from torchhand.track.knowledge.state import (
    REFIT_EVERY,
    Estimate,
    Keyframe,
    ShapeFrame,
    TrackerState,
    posture_features,
)

__all__ = [
    "REFIT_EVERY",
    "Estimate",
    "Keyframe",
    "ShapeFrame",
    "TrackerState",
    "posture_features",
    "restored_state",
    "saved_state",
]
