"""Named rigs of cameras around one place: the frame of Ueda et al. (2003), and a ring."""

import math
import re

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.errors import InputError
from torchhand.geometry import Camera

SIZE_PX, FOV_DEG = (640, 480), 63.22
"""Of the cameras of a named rig, unless the user wants others; the field of view is horizontal."""
DISTANCE = 0.4
"""Of the cameras from the middle, metres: those of a frame of 60 cm, its corners included."""

_FRAME: dict[str, tuple[float, float]] = {
    "front": (0.0, 0.0),
    "side": (90.0, 0.0),
    "top": (0.0, 90.0),
    "top45": (0.0, 45.0),
    "side45": (45.0, 0.0),
    "other_side45": (-45.0, 0.0),
    "low45": (0.0, -45.0),
    "corner": (-45.0, 35.0),
}
"""Degrees to the right of the front, and up."""
_RING_UP_DEG = 15.0
_MAX_IN_A_RING = 36
_NAME = re.compile(r"(frame|ring)(\d{0,3})")
_DEFAULTS = {"frame": 4, "ring": 8}


def named_rig(name: str, *, size: tuple[int, int] = SIZE_PX, fov_deg: float = FOV_DEG) -> list[Camera]:
    """frame3 is that of the simulator of Ueda et al. (2003, section 6.1: front, side, top), frame or frame4 that of its
    real pictures (7.1: top at 45° as well); frame1 to frame8 leave some away or add more directions. ring8 or another
    number stands around the upright axis.

    The middle is the world's origin, whose axes are those of the first camera: x right, y down, z away from it. size:
    px.

    Raises InputError for another name.
    """
    match = _NAME.fullmatch(name)
    kind, count = (match[1], int(match[2] or _DEFAULTS[match[1]])) if match else ("", 0)
    if kind == "frame" and 1 <= count <= len(_FRAME):
        places = dict(list(_FRAME.items())[:count])
    elif kind == "ring" and 2 <= count <= _MAX_IN_A_RING:
        places = {f"cam{i}": (360.0 * i / count, _RING_UP_DEG if i else 0.0) for i in range(count)}
    else:
        raise InputError(
            f"--rig: expected a file or folder of cameras, frame1 to frame{len(_FRAME)}, or ring2 to"
            f" ring{_MAX_IN_A_RING}; got {name!r}"
        )
    return [_camera(own, *place, size=size, fov_deg=fov_deg) for own, place in places.items()]


def _camera(name: str, right_deg: float, up_deg: float, *, size: tuple[int, int], fov_deg: float) -> Camera:
    width, height = size
    focal = 0.5 * width / math.tan(math.radians(0.5 * fov_deg))
    intrinsics = ((focal, 0.0, 0.5 * (width - 1)), (0.0, focal, 0.5 * (height - 1)), (0.0, 0.0, 1.0))
    return Camera(
        intrinsics=torch.tensor(intrinsics, dtype=torch.float64),
        rotation=_rotation(math.radians(right_deg), math.radians(up_deg)),
        translation=torch.tensor((0.0, 0.0, DISTANCE), dtype=torch.float64),
        distortion=torch.zeros(0, dtype=torch.float64),
        width=width,
        height=height,
        name=name,
    )


def _rotation(right: float, up: float) -> Float[Tensor, "3 3"]:
    """cam_from_world of a camera that went around the middle and up, and still looks at it."""
    s, c = math.sin(right), math.cos(right)
    around = torch.tensor(((c, 0.0, s), (0.0, 1.0, 0.0), (-s, 0.0, c)), dtype=torch.float64)
    s, c = math.sin(up), math.cos(up)
    over = torch.tensor(((1.0, 0.0, 0.0), (0.0, c, -s), (0.0, s, c)), dtype=torch.float64)
    return over @ around
