"""Named motion scripts: courses of a hand before a camera, from a seed."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.hand import FINGERS, JOINT_DOFS
from torchhand.numerics import bump, ease, wander


@dataclass(frozen=True, kw_only=True)
class Stage:
    """What a script needs to know: the clock, the chance, and the room that there is in the picture."""

    seconds: Float[Tensor, "frames"]
    progress: Float[Tensor, "frames"]
    """Time as a fraction of the sequence, 0 to 1."""
    pace: float
    """Factor on every speed."""
    generator: torch.Generator
    width: float
    """Width of the picture at the distance of the hand, metres."""
    height: float
    """Height that the picture shows at the hand's distance, metres."""
    distance: float
    """Distance of the hand from the camera, metres."""

    def wander(self, count: int) -> Float[Tensor, "frames {count}"]:
        """`count` independent smooth curves within [-1, 1] that start from rest at 0."""
        return wander(self.seconds, count, self.generator, pace=self.pace)


@dataclass(frozen=True, kw_only=True)
class Course:
    """What a script returns; camera axes (x right, y down, z forward)."""

    posture: str
    centre: Float[Tensor, "frames 3"]
    """Displacement of the middle of the hand, metres."""
    turn: Float[Tensor, "frames 3"]
    """Rotation vector about the middle of the hand."""
    joints: Float[Tensor, "frames 30"] | None = None
    """Added to the joint angles of the posture."""
    tilt_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Rotation vector of the whole sequence: an oblique view."""


def planar_course(stage: Stage, amplitude: float = 1.0) -> tuple[Float[Tensor, "frames 3"], Float[Tensor, "frames 3"]]:
    """Displacement and turn within the picture plane; `amplitude` relative to the usual one."""
    curves = amplitude * stage.wander(3)
    zero = torch.zeros_like(stage.seconds)
    centre = torch.stack((0.22 * stage.width * curves[:, 0], 0.13 * stage.height * curves[:, 1], zero), -1)
    return centre, torch.stack((zero, zero, math.radians(35) * curves[:, 2]), -1)


def _planar(stage: Stage) -> Course:
    """An open hand moves in the picture plane (Stenger et al. 2001, section 5)."""
    centre, turn = planar_course(stage)
    return Course(posture="open", centre=centre, turn=turn)


def _planar_point(stage: Stage) -> Course:
    """A pointing hand does the same."""
    centre, turn = planar_course(stage)
    return Course(posture="point", centre=centre, turn=turn)


def _abduction(stage: Stage) -> Course:
    """The fingers close and spread together, each a little on its own (Ouhaddi and Horain 1998, section 9)."""
    centre, turn = planar_course(stage, 0.25)
    together = 0.5 - 0.5 * torch.cos(2 * torch.pi * 0.35 * stage.pace * stage.seconds)
    own = stage.wander(5)
    joints = torch.zeros(len(stage.seconds), len(JOINT_DOFS), dtype=own.dtype)
    closing_deg = {"thumb_cmc": 24.0, "index_mcp": 13.0, "middle_mcp": 0.0, "ring_mcp": 8.0, "little_mcp": 19.0}
    for i, (joint, angle_deg) in enumerate(closing_deg.items()):
        joints[:, JOINT_DOFS.index(f"{joint}_aa")] = torch.deg2rad(3 * own[:, i] - angle_deg * together)
    return Course(posture="open", centre=centre, turn=turn, joints=joints)


def _bent(finger: str, amount: Float[Tensor, "frames"]) -> Float[Tensor, "frames 30"]:
    """Flexion of one whole finger, 0 straight to 1 closed."""
    if finger == "thumb":
        angles = {"thumb_cmc_fe": 30.0, "thumb_mcp_fe": 40.0, "thumb_ip_fe": 60.0}
    else:
        angles = {f"{finger}_mcp_fe": 75.0, f"{finger}_pip_fe": 95.0, f"{finger}_dip_fe": 60.0}
    full = [math.radians(angles.get(dof, 0.0)) for dof in JOINT_DOFS]
    return amount[:, None] * torch.tensor(full, dtype=amount.dtype)


def _flexion(stage: Stage) -> Course:
    """Every finger in turn, thumb to little, then all of them; seen obliquely."""
    joints = torch.zeros(len(stage.seconds), len(JOINT_DOFS), dtype=stage.seconds.dtype)
    slots = len(FINGERS) + 1
    for i, finger in enumerate(FINGERS):
        at_the_end = 0.75 if finger == "thumb" else 0.9
        amount = 0.95 * bump(slots * stage.progress - i) + at_the_end * bump(slots * stage.progress - len(FINGERS))
        joints = joints + _bent(finger, amount)
    sway = stage.wander(6)
    turn = math.radians(4) * sway[:, 3:]
    return Course(posture="open", centre=0.01 * sway[:, :3], turn=turn, joints=joints, tilt_deg=(-20.0, 28.0, 0.0))


def _free(stage: Stage) -> Course:
    """Everything moves: place and depth, 35 degrees out of the picture plane, every joint."""
    root = stage.wander(6)
    room = torch.tensor((0.2 * stage.width, 0.12 * stage.height, 0.2 * stage.distance), dtype=root.dtype)
    turn = root[:, 3:] * torch.deg2rad(torch.tensor((35.0, 35.0, 30.0), dtype=root.dtype))
    joints = math.radians(6) * stage.wander(len(JOINT_DOFS))
    for finger, amount in zip(FINGERS, stage.wander(len(FINGERS)).unbind(-1), strict=True):
        joints = joints + _bent(finger, (1.3 * amount).clamp(-1, 1) ** 2)
    spreads = [i for i, dof in enumerate(JOINT_DOFS) if dof.endswith("_aa")]
    joints[:, spreads] += math.radians(10) * stage.wander(len(spreads))
    return Course(posture="open", centre=room * root[:, :3], turn=turn, joints=joints)


def _wave(stage: Stage) -> Course:
    """An open hand waves sideways, leaning into it, comes nearer and goes away."""
    angle = 2 * torch.pi * 0.45 * stage.pace * stage.seconds
    side = angle.sin() * ease(stage.pace * stage.seconds / 0.8)
    sway = stage.wander(3)
    room = (0.22 * stage.width * side, 0.05 * stage.height * sway[:, 0], 0.2 * stage.distance * sway[:, 1])
    lean = math.radians(14) * side + math.radians(4) * sway[:, 2]
    return Course(posture="open", centre=torch.stack(room, -1), turn=torch.stack((0 * lean, 0 * lean, lean), -1))


def _greet(stage: Stage) -> Course:
    """An open hand held up to a camera: it moves and leans, its fingers close and spread, and bend a little in turn."""
    spreading = _abduction(stage)
    joints, sway = spreading.joints, stage.wander(3)
    assert joints is not None
    for i, finger in enumerate(FINGERS):
        joints = joints + 0.3 * _bent(finger, bump((0.6 * len(FINGERS) + 0.4) * stage.progress - 0.6 * i))
    lean = torch.deg2rad(torch.tensor((8.0, 10.0, 6.0), dtype=sway.dtype)) * sway
    return Course(posture="open", centre=spreading.centre, turn=spreading.turn + lean, joints=joints)


def _leave(stage: Stage) -> Course:
    """Small planar motion; the hand leaves the picture at one side, stays away for a while and comes back."""
    centre, turn = planar_course(stage, 0.4)
    away = ease((stage.progress - 0.25) / 0.15) - ease((stage.progress - 0.65) / 0.15)
    side = 1.0 if bool(torch.rand((), generator=stage.generator) < 0.5) else -1.0
    distance = side * (0.5 * stage.width + 0.8 * stage.height)
    return Course(posture="open", centre=centre + away[:, None] * torch.tensor((distance, 0.0, 0.0)), turn=turn)


SCRIPTS: dict[str, Callable[[Stage], Course]] = {
    "planar": _planar,
    "planar_point": _planar_point,
    "abduction": _abduction,
    "flexion": _flexion,
    "free": _free,
    "wave": _wave,
    "greet": _greet,
    "leave": _leave,
}
"""The named scripts; the docstring of each says what it shows."""
