"""Several paths of one hand through a recording: how far each is believed, and the hand that they tell of together."""

from torchhand.track.paths.combination import PosedHand, combined_hand
from torchhand.track.paths.paths import MOTION_NATS, HandPath, path_weights

__all__ = ["MOTION_NATS", "HandPath", "PosedHand", "combined_hand", "path_weights"]
