"""Where a hand moves that several cameras look at."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchhand.errors import InputError
from torchhand.geometry import Camera, meeting_point, sees
from torchhand.simulate.motion import filling_distance


def stage_camera(cameras: Sequence[Camera], hand_length: float) -> Camera:
    """The first camera, moved along its view so that a motion planned for it happens where all cameras look.

    That is the point nearest to their optical axes; for a single camera, before it. A hand moves there as widely as the
    first camera's picture allows where the hand fills it.

    Raises InputError where a camera does not see that point, or where there is none.
    """
    first = cameras[0].to(dtype=torch.float64, device="cpu")
    if len(cameras) == 1:
        return first
    middle = _middle([camera.to(dtype=torch.float64, device="cpu") for camera in cameras])
    centre_px = torch.tensor(((first.width - 1) / 2, (first.height - 1) / 2), dtype=torch.float64)
    plane = first.plane_from_pixels(centre_px)
    depth = torch.tensor([filling_distance(first, hand_length)], dtype=torch.float64)
    before = torch.cat((plane if first.kind == "orthographic" else plane * depth, depth))
    return replace(first, translation=before - first.rotation @ middle)


def _middle(cameras: Sequence[Camera]) -> Float[Tensor, "3"]:
    middle = meeting_point(cameras)
    blind = [camera.name for camera in cameras if not bool(sees(camera, middle[None]))]
    if blind:
        place = ", ".join(f"{metres:.2f}" for metres in middle.tolist())
        raise InputError(
            f"--rig: expected cameras that all see one place; the optical axes meet near ({place}) m, which"
            f" {', '.join(blind)} {'does' if len(blind) == 1 else 'do'} not see"
        )
    return middle
