"""A page that shows a hand while it is tracked: in space, in the picture, its angles with their bands, its rate."""

import importlib
import math
import threading
from collections import deque
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Float64, UInt8
from torch import Tensor

from torchhand.files import FrameRecord
from torchhand.files.results import DETERMINED
from torchhand.hand import DOFS, JOINT_DOFS, TIPS, HandModel, Side
from torchhand.viewer.scene import HandInScene
from torchhand.viewer.server import ViewerServer

_ROOT = len(DOFS) - len(JOINT_DOFS)
_CURVE_S = 10.0  # of the past that the curve shows
_RATE_FRAMES = 30  # over which the frame rate is taken
_FIRST_LOOK_M = 0.45  # distance from which the hand is looked at


class LivePage:
    """What a page shows of the frame that was tracked last, and what its buttons ask for."""

    def __init__(self, server: ViewerServer, model: HandModel, side: Side) -> None:
        self.server, self._model, self._side = server, model, side
        self._kinematics = model.hand(side=side, dtype=torch.float64)
        self._restart = threading.Event()
        self._past: deque[tuple[float, float, float]] = deque()  # time, angle and standard deviation of the curve's DOF
        self._arrivals: deque[float] = deque(maxlen=_RATE_FRAMES)
        self._is_placed = False
        self.scene = HandInScene(server, model, side, has_balls=True)
        self.scene.hide()
        server.scene.set_up_direction("-y")
        gui = server.gui
        self.restart = gui.add_button("Restart", icon="refresh", hint="forget the hand and find it anew")
        self.record = gui.add_checkbox("Record", False, hint="keep the camera's pictures as a video")
        self.told = gui.add_markdown("waiting for the first picture")
        self.picture = gui.add_image(np.zeros((2, 2, 3), np.uint8), format="jpeg")
        self.angle = gui.add_dropdown("Angle", JOINT_DOFS, initial_value="index_pip_fe")
        self.curve = gui.add_uplot(**_curve(np.zeros((1, 3))), aspect=2.2)
        with gui.add_folder("All angles", expand_by_default=True):
            self.angles = gui.add_html("")
        self.restart.on_click(lambda _: self._restart.set())
        self.angle.on_update(lambda _: self._past.clear())

    @property
    def records(self) -> bool:
        """Whether pictures are to be kept."""
        return bool(self.record.value)

    def takes_restart(self) -> bool:
        """Whether the hand is to be found anew, asked once."""
        is_asked = self._restart.is_set()
        self._restart.clear()
        return is_asked

    def show(
        self,
        record: FrameRecord,
        shape: Float[Tensor, "shape"] | None,
        picture: UInt8[Tensor, "height width 3"] | None,
        facts: dict[str, str],
    ) -> None:
        """Show a frame. shape: proportions, where they are known. facts: further words by name."""
        time_s = 0.0 if record.time_s is None else record.time_s
        self._arrivals.append(time_s)
        with self.server.atomic():
            if picture is not None:
                self.picture.image = picture.numpy()
            self._show_hand(record, shape)
            self._show_angles(record, time_s)
            self.told.content = self._words(record, facts)

    def _show_hand(self, record: FrameRecord, shape: Float64[Tensor, "shape"] | None) -> None:
        if shape is None or not np.isfinite(record.pose).all():
            self.scene.hide()
            return
        with torch.inference_mode():
            self.scene.show(self._kinematics(torch.from_numpy(record.pose), shape.double()).vertices)
        tips = list(TIPS)
        std = np.sqrt(np.einsum("kii->k", record.keypoints3d_cov[tips]).clip(min=0) / 3)
        quality = np.ones(len(tips)) if record.finger_quality is None else record.finger_quality
        self.scene.show_tips(record.keypoints3d[tips], std, quality >= DETERMINED)
        if not self._is_placed:
            self._look_at(record.keypoints3d.mean(0))

    def _look_at(self, middle: Float[np.ndarray, "3"]) -> None:
        """Look at the hand as the camera does, in pages that are open and in those to come."""
        self._is_placed = True
        camera, place = self.server.initial_camera, tuple(middle - (0.0, 0.0, _FIRST_LOOK_M))
        camera.position, camera.look_at, camera.up = place, tuple(middle), (0.0, -1.0, 0.0)
        for client in self.server.get_clients().values():
            client.camera.position, client.camera.look_at, client.camera.up_direction = place, middle, (0.0, -1.0, 0.0)

    def _show_angles(self, record: FrameRecord, time_s: float) -> None:
        value, std = np.rad2deg(record.pose[_ROOT:]), np.rad2deg(record.pose_std[_ROOT:])
        index = JOINT_DOFS.index(self.angle.value)
        self._past.append((time_s, float(value[index]), float(std[index])))
        while self._past and self._past[0][0] < time_s - _CURVE_S:
            self._past.popleft()
        self.curve.data = _curve(np.array(self._past))["data"]
        skeleton = self._model.skeleton
        low, high = (np.rad2deg(limit.numpy()) for limit in (skeleton.lower, skeleton.upper))
        rows = zip(JOINT_DOFS, value.tolist(), std.tolist(), low.tolist(), high.tolist(), strict=True)
        self.angles.content = f'<table style="width:100%;font-size:11px">{"".join(_bar(*row) for row in rows)}</table>'

    def _words(self, record: FrameRecord, facts: dict[str, str]) -> str:
        spent_s = self._arrivals[-1] - self._arrivals[0]
        rate = (len(self._arrivals) - 1) / spent_s if spent_s > 0 else 0.0
        reason = f" ({record.reason})" if record.reason else ""
        lines = [f"**{record.status.replace('_', ' ')}**{reason}, frame {record.frame}, {record.time_s or 0:.2f} s"]
        lines.append(f"shown {rate:.1f} times a second, tracked in {1e3 * record.seconds:.0f} ms")
        return "\n\n".join([*lines, *(f"{name}: {text}" for name, text in facts.items())])


def _curve(past: Float[np.ndarray, "t 3"]) -> dict[str, Any]:
    """An angle over time and the band of one standard deviation."""
    uplot: Any = importlib.import_module("viser.uplot")

    time_s, value, std = past.T
    strokes = (("low", "#9ecae1", 1), ("high", "#9ecae1", 1), ("degrees", "#1f77b4", 2))
    series = (uplot.Series(label="s"), *(uplot.Series(label=a, stroke=b, width=c) for a, b, c in strokes))
    bands = (uplot.Band(series=(2, 1), fill="rgba(31, 119, 180, 0.15)"),)
    scales = {"x": uplot.Scale(time=False), "y": uplot.Scale(auto=True)}
    return {"data": (time_s, value - std, value + std, value), "series": series, "bands": bands, "scales": scales}


def _bar(name: str, value: float, std: float, low: float, high: float) -> str:
    """A row of a table: the angle's name, its place between its limits with its band, and its number."""
    if not math.isfinite(value):
        return f"<tr><td>{name}</td><td></td><td>–</td></tr>"

    def place(angle: float) -> float:
        return 100 * min(max((angle - low) / (high - low), 0.0), 1.0) if high > low else 0.0

    band = f"left:{place(value - std):.1f}%;width:{max(place(value + std) - place(value - std), 0.5):.1f}%"
    bar = "position:absolute;top:0;height:100%"
    return (
        f"<tr><td>{name}</td><td style='width:50%'>"
        "<div style='position:relative;height:9px;background:#ddd'>"
        f"<div style='{bar};{band};background:#9ecae1'></div>"
        f"<div style='{bar};left:{place(value):.1f}%;width:2px;background:#1f77b4'></div>"
        f"</div></td><td style='text-align:right'>{value:z.0f}° ± {std:.0f}°</td></tr>"
    )
