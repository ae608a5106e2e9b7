"""Write a hand model's hand.urdf from its shape.json and the anatomy, and its preview.png."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import cv2
import torch
from jaxtyping import Float, UInt8
from torch import Tensor
from tyro.conf import arg

from torchhand.cli.command import DONE, command, parse
from torchhand.errors import InputError
from torchhand.files.hand_model import HandModel, read_shape_space
from torchhand.files.locations import models_dir
from torchhand.files.safe_write import replacing, write_text
from torchhand.files.urdf import read_skeleton, skeleton_to_urdf
from torchhand.geometry import assumed_camera, rotation_from_vector
from torchhand.hand import place_primitives, posture, primitive_sizes
from torchhand.hand.anatomy import anatomical_skeleton
from torchhand.view import raycast, shade

PREVIEW_POSTURES = ("open", "fist", "point")
_TILE_PX = 320
_FIELD_OF_VIEW_DEG = 22.0
_DISTANCE = 0.6  # metres
_MIDDLE = 0.5  # of hand length, which lies in the middle of a tile

# Where the hand frame's x, y and z point in the camera's frame.
_PALM = ((0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0))
_BACK = ((0.0, 0.0, -1.0), (0.0, -1.0, 0.0), (-1.0, 0.0, 0.0))
_THUMB_SIDE = ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0))
_OBLIQUE_TURN = (0.5, 0.7, 0.0)  # rotation vector applied to the back view


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Write a hand model's hand.urdf from its shape.json and the anatomy, and its preview.png.

    Example:
        torchhand build_hand --out models/generic_hand
    """

    out: Annotated[Path | None, arg(metavar="DIR")] = None
    """Model folder; it must hold shape.json. The shipped generic_hand if not given."""


@command
def main(argv: Sequence[str] | None = None) -> int:
    """Build one model folder."""
    folder = parse(Arguments, argv, name="build_hand").out or models_dir() / "generic_hand"
    if not (folder / "shape.json").is_file():
        raise InputError(f"{folder}: expected a model folder with shape.json; there is none")
    space = read_shape_space(folder / "shape.json")
    urdf = folder / "hand.urdf"
    write_text(urdf, skeleton_to_urdf(anatomical_skeleton(space), folder.resolve().name))
    print(f"saved {urdf}")
    picture = folder / "preview.png"
    model = HandModel(name=folder.name, skeleton=read_skeleton(urdf), shape_space=space)
    with replacing(picture) as temporary:
        cv2.imwrite(str(temporary), cv2.cvtColor(preview(model).numpy(), cv2.COLOR_RGB2BGR))
    print(f"saved {picture}")
    return DONE


def preview(model: HandModel, *, tile_px: int = _TILE_PX) -> UInt8[Tensor, "height width 3"]:
    """Ray-cast pictures of the right hand: one row per posture; palm, back, thumb side and oblique in the columns."""
    palm, back, side = (torch.tensor(axes, dtype=torch.float64).T for axes in (_PALM, _BACK, _THUMB_SIDE))
    oblique = rotation_from_vector(torch.tensor(_OBLIQUE_TURN, dtype=torch.float64)) @ back
    views = (palm, back, side, oblique)
    rows = [torch.cat([_tile(model, name, view, tile_px) for view in views], 1) for name in PREVIEW_POSTURES]
    return torch.cat(rows)


def _tile(model: HandModel, posture_name: str, cam_from_hand: Float[Tensor, "3 3"], size_px: int) -> Tensor:
    kinematics = model.kinematics(dtype=torch.float64)
    shape = kinematics.default_shape
    pose = posture(posture_name)
    pose[:3] = -cam_from_hand[:, 1] * _MIDDLE * model.shape_space.metric(shape)["hand_length"]
    pose[2] += _DISTANCE
    frames = kinematics(pose, root_reference=cam_from_hand)
    placed = place_primitives(frames, primitive_sizes(model.shape_space, shape))
    return shade(raycast(placed, assumed_camera(size_px, size_px, horizontal_fov_deg=_FIELD_OF_VIEW_DEG)))
