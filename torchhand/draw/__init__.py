"""Pictures of results: overlays and contact sheets."""

from torchhand.draw.overlay import STATUS_COLOURS, draw_overlay, overlay_size
from torchhand.draw.second_view import draw_second_view
from torchhand.draw.sheet import contact_sheet

__all__ = ["STATUS_COLOURS", "contact_sheet", "draw_overlay", "draw_second_view", "overlay_size"]
