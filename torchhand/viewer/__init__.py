"""Pages on 127.0.0.1 with hands in 3D: one that is edited, a result, one that is tracked. They need viser."""

from torchhand.viewer.edited_hand import EditedHand
from torchhand.viewer.hand_page import HandPage
from torchhand.viewer.live_page import LivePage
from torchhand.viewer.result_page import ResultPage
from torchhand.viewer.server import ViewerServer, address_of, opened_server

__all__ = ["EditedHand", "HandPage", "LivePage", "ResultPage", "ViewerServer", "address_of", "opened_server"]
