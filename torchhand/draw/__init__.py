"""Pictures of results: overlays and contact sheets."""

from torchhand.draw.calibration_report import write_report
from torchhand.draw.chart import Axes, draw_chart
from torchhand.draw.hand_picture import HandPainter, draw_trace, write_sign, write_word
from torchhand.draw.overlay import STATUS_COLOURS, draw_overlay, overlay_size
from torchhand.draw.second_view import draw_second_view
from torchhand.draw.sheet import contact_sheet
from torchhand.draw.views import ViewsOverlay

__all__ = [
    "STATUS_COLOURS",
    "Axes",
    "HandPainter",
    "ViewsOverlay",
    "contact_sheet",
    "draw_chart",
    "draw_overlay",
    "draw_second_view",
    "draw_trace",
    "overlay_size",
    "write_report",
    "write_sign",
    "write_word",
]
