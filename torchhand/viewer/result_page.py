"""A page that shows a result over time: a slider, a hand in space, one angle's curve with its band, status in words."""

import importlib
import threading
import time
from typing import Any

import numpy as np
import torch
from jaxtyping import Float64
from torch import Tensor

from torchhand.files import Track
from torchhand.files.results import DETERMINED
from torchhand.hand import DOFS, FINGERS, JOINT_DOFS, TIPS, HandModel, Side
from torchhand.viewer.scene import HandInScene
from torchhand.viewer.server import ViewerServer

_ROOT = len(DOFS) - len(JOINT_DOFS)
_TICK_S = 0.04


class ResultPage:
    """The frames of one track, in the world that its poses are in (a camera's, y down and z forward)."""

    def __init__(
        self,
        server: ViewerServer,
        track: Track,
        model: HandModel,
        *,
        side: Side,
        shape: Float64[Tensor, "shape"],
        fps: float,
    ) -> None:
        """fps: frames a second, where the track tells no times."""
        self.server, self.track = server, track
        self.times_s = np.asarray(track.frame / fps if track.time_s is None else track.time_s)
        self.hand = model.hand(shape, side=side, dtype=torch.float64)
        self._lock, self._stopped = threading.RLock(), threading.Event()
        self.playing_since: tuple[float, float] | None = None
        """When playing began, by the clock, and at what time of the track; None while it stands."""
        self.scene = HandInScene(server, model, side, has_balls=True)
        self._set_stage()
        gui = server.gui
        self.frame = gui.add_slider("Frame", 0, max(len(track) - 1, 1), 1, 0, hint="the row of the track")
        self.play = gui.add_checkbox("Play", False)
        self.speed = gui.add_slider("Speed", 0.1, 2.0, 0.1, 1.0)
        self.told = gui.add_markdown("")
        self.angle = gui.add_dropdown("Angle", JOINT_DOFS, initial_value="index_mcp_fe")
        self.curve = gui.add_uplot(**self._curve_of("index_mcp_fe"), aspect=1.6)
        self.frame.on_update(lambda _: self.show(int(self.frame.value)))
        self.play.on_update(lambda _: self._set_playing(self.play.value))
        self.speed.on_update(lambda _: self._set_playing(self.play.value))
        self.angle.on_update(lambda _: self._show_curve(self.angle.value))
        known = np.flatnonzero(track.has_hand)
        self.frame.value = int(known[0]) if len(known) else 0
        self.show(self.frame.value)

    def show(self, row: int) -> None:
        """Show one frame."""
        track = self.track
        with self._lock, self.server.atomic():
            if track.has_hand[row]:
                with torch.inference_mode():
                    self.scene.show(self.hand(torch.from_numpy(track.pose[row])).vertices)
                self._show_tips(row)
            else:
                self.scene.hide()
            self.told.content = self._words(row)

    def run(self) -> None:
        """Let the frames go on while "Play" is set, until `stop`."""
        while not self._stopped.wait(_TICK_S):
            self.advance(time.monotonic())

    def advance(self, now_s: float) -> None:
        """Show the frame whose time it is, where frames are playing; from the last one on to the first."""
        if self.playing_since is None:
            return
        started_s, first_s = self.playing_since
        length_s = max(self.times_s[-1] - self.times_s[0], 1e-3) + _TICK_S
        at_s = self.times_s[0] + (first_s - self.times_s[0] + (now_s - started_s) * self.speed.value) % length_s
        row = int(np.searchsorted(self.times_s, at_s, side="right")) - 1
        if row != self.frame.value:
            self.frame.value = row

    def stop(self) -> None:
        """End `run`."""
        self._stopped.set()

    def _set_playing(self, is_playing: bool) -> None:
        now_s = time.monotonic()
        self.playing_since = (now_s, float(self.times_s[int(self.frame.value)])) if is_playing else None

    def _set_stage(self) -> None:
        self.server.scene.set_up_direction("-y")
        points = self.track.keypoints3d[self.track.has_hand]
        middle = np.median(points.reshape(-1, 3), axis=0) if len(points) else np.array([0.0, 0.0, 0.5])
        camera = self.server.initial_camera
        camera.position, camera.look_at = tuple(middle - (0.0, 0.0, 0.45)), tuple(middle)
        camera.up = (0.0, -1.0, 0.0)

    def _show_tips(self, row: int) -> None:
        track, tips = self.track, list(TIPS)
        variance = np.einsum("kii->k", track.keypoints3d_cov[row][tips]) / 3
        quality = np.ones(len(tips)) if track.finger_quality is None else track.finger_quality[row]
        self.scene.show_tips(track.keypoints3d[row][tips], np.sqrt(np.maximum(variance, 0.0)), quality >= DETERMINED)

    def _words(self, row: int) -> str:
        track = self.track
        lines = [f"**{track.status[row]}**, frame {track.frame[row]}, {self.times_s[row]:.3f} s"]
        if track.reason is not None and track.reason[row]:
            lines.append(str(track.reason[row]))
        if track.finger_quality is not None and track.has_hand[row]:
            unsure = [name for name, q in zip(FINGERS, track.finger_quality[row], strict=True) if q < DETERMINED]
            lines.append(f"not determined: {', '.join(unsure) or 'none'}")
        index = _ROOT + JOINT_DOFS.index(self.angle.value)
        if track.has_hand[row]:
            value, std = (float(np.rad2deg(array[row, index])) for array in (track.pose, track.pose_std))
            lines.append(f"{self.angle.value}: {value:z.1f}° ± {std:.1f}°")
        return "\n\n".join(lines)

    def _show_curve(self, dof: str) -> None:
        self.curve.data = self._curve_of(dof)["data"]
        self.show(int(self.frame.value))

    def _curve_of(self, dof: str) -> dict[str, Any]:
        """The angle over time and the band of one standard deviation, degrees."""
        uplot: Any = importlib.import_module("viser.uplot")

        index = _ROOT + JOINT_DOFS.index(dof)
        value, std = (np.rad2deg(array[:, index]) for array in (self.track.pose, self.track.pose_std))
        series = [uplot.Series(label="s")]
        for label, width in (("low", 1), ("high", 1), ("degrees", 2)):
            stroke = "#1f77b4" if label == "degrees" else "#9ecae1"
            series.append(uplot.Series(label=label, stroke=stroke, width=width))
        bands = (uplot.Band(series=(2, 1), fill="rgba(31, 119, 180, 0.15)"),)
        scales = {"x": uplot.Scale(time=False), "y": uplot.Scale(auto=True)}
        data = (self.times_s, value - std, value + std, value)
        return {"data": data, "series": tuple(series), "bands": bands, "scales": scales}
