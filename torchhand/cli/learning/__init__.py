"""What the ways of `torchhand learn_pose` share, and the one from pictures."""

from torchhand.cli.learning.folders import check_same, check_training_folder
from torchhand.cli.learning.from_pictures import PictureJob, Sources, learn_from_pictures

__all__ = ["PictureJob", "Sources", "check_same", "check_training_folder", "learn_from_pictures"]
