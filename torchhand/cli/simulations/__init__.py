"""What `torchhand simulate` is ordered to show: the hand, its motion and the cameras."""

from torchhand.cli.simulations.actor import Actor, actor_of, camera_of, motion_of
from torchhand.cli.simulations.order import Arguments
from torchhand.cli.simulations.rig import rig_cameras, rig_complaints, with_mask_noise

__all__ = [
    "Actor",
    "Arguments",
    "actor_of",
    "camera_of",
    "motion_of",
    "rig_cameras",
    "rig_complaints",
    "with_mask_noise",
]
