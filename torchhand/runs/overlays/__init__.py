"""Overlays of tracked hands as videos: of one camera, and of several side by side."""

from torchhand.runs.overlays.one_camera import draw_live, drawn_over, overlay_frames, write_overlay
from torchhand.runs.overlays.rig import write_views

__all__ = ["draw_live", "drawn_over", "overlay_frames", "write_overlay", "write_views"]
