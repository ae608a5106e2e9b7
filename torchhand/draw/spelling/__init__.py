"""Words spelled by a hand, drawn; a room of its own, for what draws an overlay need not wait for signs and exports."""

from torchhand.draw.spelling.video import paint_spelling, spelling_camera

__all__ = ["paint_spelling", "spelling_camera"]
