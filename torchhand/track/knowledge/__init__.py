"""What a tracker knows between two frames, what it says of one, and both as plain tensors."""

from torchhand.track.knowledge.checkpoint import restored_state, saved_state
from torchhand.track.knowledge.state import Estimate, Keyframe, ShapeFrame, TrackerState

__all__ = ["Estimate", "Keyframe", "ShapeFrame", "TrackerState", "restored_state", "saved_state"]
