"""A page on which a hand is played with: every angle, every proportion, limits and couplings, postures and signs."""

import math
import threading
from typing import Any

from torchhand.hand import DOFS, FINGERS, JOINT_DOFS, POSTURES
from torchhand.hand.limits import TIES
from torchhand.signs import SIGNS
from torchhand.viewer.edited_hand import EditedHand
from torchhand.viewer.scene import HandInScene
from torchhand.viewer.server import ViewerServer

_ROOT = DOFS[: len(DOFS) - len(JOINT_DOFS)]
_REACH_MM, _TURN_DEG = 300.0, 180.0
_NOTHING = "–"
_KINDS = {"fe": "flexion", "aa": "abduction", "tw": "twist"}


class HandPage:
    """The controls of one `EditedHand` and its picture. Every change of a control is a change of the hand."""

    def __init__(self, server: ViewerServer, hand: EditedHand) -> None:
        self.server, self.hand = server, hand
        self._lock, self._is_filling = threading.RLock(), False
        self.scene = HandInScene(server, hand.model, hand.side)
        self._set_stage()
        self.angles: dict[str, Any] = {}
        """Sliders by degree of freedom: degrees, and millimetres of the wrist's place."""
        self.parameters: dict[str, Any] = {}
        """Sliders of the proportions by name, in their own units."""
        self.exports: dict[str, Any] = {}
        """Buttons by the file that they send."""
        self.told = server.gui.add_markdown("")
        tabs = server.gui.add_tab_group()
        with tabs.add_tab("Postures"):
            self._add_postures()
        with tabs.add_tab("Angles"):
            self._add_angles()
        with tabs.add_tab("Proportions"):
            self._add_proportions()
        with tabs.add_tab("Export"):
            self._add_exports()
        self.refresh()

    def refresh(self) -> None:
        """Show the hand as it is, in the scene, in every control and in words."""
        with self._lock, self.server.atomic():
            self._is_filling = True
            try:
                for dof, slider in self.angles.items():
                    slider.value = _shown(dof, float(self.hand.pose[DOFS.index(dof)]))
                for place, slider in enumerate(self.parameters.values()):
                    slider.value = round(float(self.hand.shape[place]), 4)
            finally:
                self._is_filling = False
            self.scene.show(self.hand.state().vertices)
            self.told.content = "\n\n".join(f"**{name}**: {text}" for name, text in self.hand.told().items())

    def _set_stage(self) -> None:
        self.server.scene.set_up_direction("+y")
        self.server.scene.add_grid("/ground", width=0.6, height=0.6, cell_size=0.02, plane="xz", position=(0, -0.03, 0))
        camera, middle = self.server.initial_camera, (0.0, 0.09, 0.0)
        camera.position, camera.look_at, camera.up = (-0.38, 0.16, 0.12), middle, (0.0, 1.0, 0.0)

    def _add_postures(self) -> None:
        gui, hand = self.server.gui, self.hand
        self.posture = gui.add_dropdown("Posture", [_NOTHING, *POSTURES])
        self.sign = gui.add_dropdown("Sign", [_NOTHING, *SIGNS], hint="the manual alphabet and the digits")
        self.with_shape = gui.add_checkbox("with proportions", False, hint="draw somebody's proportions too")
        self.draw = gui.add_button("Draw from the prior", icon="dice")
        self.feasible = gui.add_button("Nearest possible posture", hint="within limits and couplings between fingers")
        self.follows = gui.add_checkbox("led angles follow", hand.follows, hint="\n".join(tie.name for tie in TIES))
        self.default_shape = gui.add_button("Default proportions")
        self.posture.on_update(lambda _: self._change(hand.take_posture, self.posture))
        self.sign.on_update(lambda _: self._change(hand.take_sign, self.sign))
        self.draw.on_click(lambda _: self._do(lambda: hand.draw(with_shape=self.with_shape.value)))
        self.feasible.on_click(lambda _: self._do(hand.make_feasible))
        self.follows.on_update(lambda _: self._do(lambda: hand.set_follows(self.follows.value)))
        self.default_shape.on_click(lambda _: self._do(hand.reset_shape))

    def _add_angles(self) -> None:
        for name, dofs in _by_digit(DOFS).items():
            with self.server.gui.add_folder(name, expand_by_default=name == "index"):
                for dof in dofs:
                    self.angles[dof] = self._angle_slider(dof)

    def _angle_slider(self, dof: str) -> Any:
        if dof in _ROOT:
            reach = _REACH_MM if dof[5] == "t" else _TURN_DEG
            low, high, hint = -reach, reach, "the wrist's place, mm" if dof[5] == "t" else "rotation vector, degrees"
        else:
            low, high = (math.degrees(limit) for limit in self.hand.limits(dof))
            ties = [tie.name for tie in TIES if JOINT_DOFS.index(dof) in (tie.source, tie.target)]
            hint = "; ".join([f"{_KINDS[dof[-2:]]}, {low:.0f}° to {high:.0f}°", *ties])
        label = dof.removeprefix("root_") if dof in _ROOT else dof.partition("_")[2]
        slider = self.server.gui.add_slider(
            label, min=round(low, 1), max=round(high, 1), step=0.1, initial_value=0.0 if low <= 0 <= high else low,
            marks=tuple((round(limit, 1), f"{limit:.0f}") for limit in (low, high)), hint=hint,
        )  # fmt: skip
        slider.on_update(lambda _: self._do(lambda: self.hand.set_dof(dof, _inner(dof, slider.value))))
        return slider

    def _add_proportions(self) -> None:
        space = self.hand.model.shape_space
        for folder, names in _by_digit(space.names).items():
            with self.server.gui.add_folder(folder, expand_by_default=folder == "hand"):
                for name in names:
                    self.parameters[name] = self._parameter_slider(name)
        self.parameters = {name: self.parameters[name] for name in space.names}

    def _parameter_slider(self, name: str) -> Any:
        space = self.hand.model.shape_space
        index = space.names.index(name)
        low, high, default, std = (float(one[index]) for one in (space.lower, space.upper, space.default, space.std))
        unit = {"m": "metres", "/HL": "of the hand's length", "/HB": "of the hand's breadth"}[space.units[index]]
        slider = self.server.gui.add_slider(
            name, min=low, max=high, step=1e-4, initial_value=default,
            hint=f"{unit}; {default:.4g} ± {std:.2g} over people",
        )  # fmt: skip
        slider.on_update(lambda _: self._do(lambda: self.hand.set_parameter(name, slider.value)))
        return slider

    def _add_exports(self) -> None:
        for label, file, content in (
            ("pose.json: angles, proportions, keypoints", "pose.json", self.hand.as_json),
            ("hand.obj: the skin", "hand.obj", self.hand.as_obj),
        ):
            button = self.exports[file] = self.server.gui.add_button(label, icon="download")
            button.on_click(lambda event, file=file, content=content: self._send(event, file, content()))

    def _send(self, event: Any, file: str, text: str) -> None:
        receiver = event.client or self.server
        receiver.send_file_download(
            file, text.encode(), save_immediately=True
        )  # else a link is shown that is easily missed

    def _change(self, take: Any, choice: Any) -> None:
        """What a list does: its entry is taken, and it goes back to none."""
        name = choice.value
        if name != _NOTHING:
            self._do(lambda: take(name))

    def _do(self, change: Any) -> None:
        """Change the hand as a control says, unless the page itself has filled the control in."""
        with self._lock:
            if self._is_filling:
                return
            change()
            self.refresh()


def _by_digit(names: tuple[str, ...]) -> dict[str, list[str]]:
    """Names under the digit that they begin with; those of none under "hand"."""
    groups: dict[str, list[str]] = {"hand": []}
    for name in names:
        first = name.partition("_")[0]
        groups.setdefault(first if first in FINGERS else "hand", []).append(name)
    return groups


def _shown(dof: str, value: float) -> float:
    """As a slider tells it: degrees, or millimetres."""
    return round(1e3 * value if dof in _ROOT[:3] else math.degrees(value), 1)


def _inner(dof: str, shown: float) -> float:
    return shown / 1e3 if dof in _ROOT[:3] else math.radians(shown)
