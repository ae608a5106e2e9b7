"""The hand in three dimensions, seen from beside the camera (the right halves of figures 6 and 7 of Stenger et al.
2001)."""

import math
from dataclasses import replace

import cv2
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from torchhand.geometry import assumed_camera, rotation_from_vector
from torchhand.hand import Hand, place_primitives, posed_mesh
from torchhand.view import HandProjector, Surface, cast, shade

TURN_DEG = 50.0
"""How far the second camera stands to the right of the first, seen from the hand's middle."""
PAPER = (244, 244, 240)
"""RGB of the empty background."""

_BLUR_PX = 0.6
_FOV_DEG = 20.0
_MIDDLE = 0.48  # of the hand, share of its length from the wrist
_REACH = 1.25  # side of the square that is seen at the hand, in hand lengths


def draw_second_view(
    projector: HandProjector,
    pose: Float[Tensor, "36"],
    root_reference: Float[Tensor, "3 3"],
    size: int,
    *,
    turn_deg: float = TURN_DEG,
    hand: Hand | None = None,
) -> UInt8[Tensor, "{size} {size} 3"]:
    """A shaded RGB picture of the hand alone, square.

    The second camera is upright as the first is, has gone to the right round the hand by `turn_deg` about the vertical
    axis, and always looks at the middle of the hand from the same distance: only posture and orientation are seen.
    The skin of `hand` is drawn where that is given (of the projector's side and dtype), else the primitives.
    """
    kinematics = projector.kinematics
    frames = projector.frames(pose, root_reference)
    surface: Surface
    if hand is None:
        surface = place_primitives(frames, projector.sizes, is_left=kinematics.side == "left")
    else:
        surface = posed_mesh(hand, hand(pose, projector.shape, root_reference=root_reference))
    length = kinematics.shape_space.metric(projector.shape)["hand_length"]
    middle = frames.position[0] + _MIDDLE * length * frames.rotation[0][:, 1]
    camera = assumed_camera(size, size, horizontal_fov_deg=_FOV_DEG, dtype=pose.dtype)
    distance = 0.5 * _REACH * length / math.tan(math.radians(_FOV_DEG / 2))
    down = torch.tensor((0.0, math.radians(turn_deg), 0.0), dtype=pose.dtype)
    rotation = rotation_from_vector(down) @ projector.camera.rotation
    translation = -(rotation @ middle)
    translation[2] += distance
    camera = replace(camera, rotation=rotation, translation=translation)
    paper = torch.tensor(PAPER, dtype=torch.uint8).expand(size, size, 3)
    return _smoothed(shade(cast(surface, camera), background=paper))


def _smoothed(picture: UInt8[Tensor, "size size 3"]) -> UInt8[Tensor, "size size 3"]:
    """A little blur against the stairs of one ray per pixel."""
    return torch.from_numpy(cv2.GaussianBlur(picture.cpu().numpy(), (0, 0), _BLUR_PX))
