"""A hand in the scene of a page: its skin, and how sure each fingertip is."""

import numpy as np
from jaxtyping import Float
from torch import Tensor

from torchhand.hand import TIPS, HandModel, Side
from torchhand.viewer.server import ViewerServer

_SKIN = (224, 172, 138)
_SURE, _UNSURE = (60, 160, 90), (220, 60, 50)
_LARGEST_M = 0.06  # radius of a ball: more uncertain than this is all the same


class HandInScene:
    """The skin of one hand, and a ball about each fingertip as large as its standard deviation."""

    def __init__(self, server: ViewerServer, model: HandModel, side: Side, *, has_balls: bool = False) -> None:
        faces = model.hand(side=side).faces.numpy()
        points = np.zeros((int(faces.max()) + 1, 3), np.float32)
        self.skin = server.scene.add_mesh_simple("/hand", points, faces, color=_SKIN, material="standard")
        self.balls = [
            server.scene.add_icosphere(f"/tips/{place}", radius=1.0, color=_SURE, opacity=0.35, visible=False)
            for place in range(len(TIPS) if has_balls else 0)
        ]

    def show(self, vertices: Float[Tensor, "vertices 3"]) -> None:
        """Put the skin there."""
        self.skin.vertices = np.ascontiguousarray(vertices.float().numpy())
        self.skin.visible = True

    def show_tips(
        self, points: Float[np.ndarray, "5 3"], std_m: Float[np.ndarray, "5"], is_determined: np.ndarray
    ) -> None:
        """Balls of one standard deviation; red where the finger is not determined."""
        for ball, point, radius, is_sure in zip(self.balls, points, std_m, is_determined, strict=True):
            ball.position = tuple(point.tolist())
            ball.scale = float(min(radius, _LARGEST_M))
            ball.color = _SURE if is_sure else _UNSURE
            ball.visible = True

    def hide(self) -> None:
        """Show no hand."""
        self.skin.visible = False
        for ball in self.balls:
            ball.visible = False
