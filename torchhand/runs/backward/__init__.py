"""The backward pass of a recorded run: followed from its end, compared with the forward pass, one result from both."""

from torchhand.runs.backward.second_pass import smooth_frames

__all__ = ["smooth_frames"]
