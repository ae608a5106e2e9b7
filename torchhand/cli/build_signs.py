"""Solve the joint angles of the manual alphabet's signs, and draw them all on one sheet."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import cv2
import torch
from jaxtyping import Float64, UInt8
from torch import Tensor
from tyro.conf import arg

from torchhand.cli.command import DONE, command, parse, threads
from torchhand.draw import HandPainter, contact_sheet, draw_trace, write_sign
from torchhand.draw.spelling import spelling_camera
from torchhand.errors import InputError
from torchhand.files import load_hand_model, models_dir
from torchhand.files.disk import expanded, replacing
from torchhand.geometry import rotation_from_vector, vector_from_rotation
from torchhand.hand import KEYPOINTS, HandModel
from torchhand.signs import SIGNS, SIGNS_NAME, TRACERS, load_signs, save_signs, solve_signs, standing_pose, traced_poses

SHEET_NAME = "signs.png"
_COLUMNS, _PAIRS, _TILE_PX, _SMOOTHING = 9, 6, 128, 2
_ROOM = 0.25  # metres that a tile shows
_TRACE_PLACES = 60
_SIDE_DEG = -60.0  # shows the side of a raised right hand that the little finger is on


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Solve the joint angles of the manual alphabet's signs, and draw them all on one sheet.

    Writes signs.json (which `torchhand animate` reads) and signs.png into the folder of the model. About half a minute.

    Example:
        torchhand build_signs
    """

    out: Annotated[Path | None, arg(metavar="DIR")] = None
    """Folder for both files; that of the generic hand without it."""
    sheet_only: bool = False
    """Draw signs.png from the signs.json that is there."""
    two_views: Annotated[Path | None, arg(metavar="FILE")] = None
    """A PNG file for a second sheet: every sign as a viewer sees it, and beside that turned to its side."""


@command
def main(argv: Sequence[str] | None = None) -> int:
    """Solve, save, draw."""
    arguments = parse(Arguments, argv, name="build_signs")
    folder = models_dir() / "generic_hand" if arguments.out is None else expanded(arguments.out)
    if not folder.is_dir():
        raise InputError(f"--out: expected an existing folder, got {folder}")
    model = load_hand_model()
    with threads(1):
        if not arguments.sheet_only:
            solved = solve_signs(model.kinematics(dtype=torch.float64), SIGNS)
            save_signs(folder / SIGNS_NAME, SIGNS, solved.joints)
            deepest, off = (1e3 * float(x.max()) for x in (solved.overlap.depth, solved.contact))
            print(f"{len(SIGNS)} signs: parts overlap by {deepest:.2f} mm at most, contacts within {off:.1f} mm")
        joints = load_signs(folder / SIGNS_NAME)
        _write(folder / SHEET_NAME, sign_sheet(model, joints))
        if arguments.two_views is not None:
            _write(expanded(arguments.two_views), sign_sheet(model, joints, turns_deg=(0.0, _SIDE_DEG)))
    print(f"saved {folder / SIGNS_NAME} and {folder / SHEET_NAME}")
    return DONE


def _write(path: Path, sheet: UInt8[Tensor, "height width 3"]) -> None:
    written, encoded = cv2.imencode(
        ".png", cv2.cvtColor(sheet.numpy(), cv2.COLOR_RGB2BGR), (cv2.IMWRITE_PNG_COMPRESSION, 9)
    )
    assert written
    with replacing(path) as temporary:
        temporary.write_bytes(encoded.tobytes())


def sign_sheet(
    model: HandModel, joints: dict[str, Float64[Tensor, "30"]], *, turns_deg: Sequence[float] = (0.0,)
) -> UInt8[Tensor, "height width 3"]:
    """All signs side by side, as a viewer sees the right hand that is turned about the vertical by each of these."""
    hand = model.hand(dtype=torch.float32)
    length = float(model.shape_space.metric(model.shape_space.default)["hand_length"])
    camera = spelling_camera(_TILE_PX, _TILE_PX, length, room=_ROOM)
    painter = HandPainter(hand, camera, smoothing=_SMOOTHING)
    tiles = []
    for sign in SIGNS:
        poses = torch.stack([_turned(standing_pose(sign, joints[sign], model), turn) for turn in turns_deg])
        surfaces = painter.surfaces(poses)
        for i, turn in enumerate(turns_deg):
            tile = painter.paint(surfaces.select(i))
            if sign in TRACERS and turn == 0:
                draw_trace(tile, camera.project(_trace(model, sign, joints[sign])))
            write_sign(tile, sign)
            tiles.append(tile)
    return contact_sheet(tiles, _COLUMNS if len(turns_deg) == 1 else _PAIRS * len(turns_deg), gap_px=2)


def _turned(pose: Float64[Tensor, "36"], degrees: float) -> Float64[Tensor, "36"]:
    """The hand turned about the vertical through the origin of a camera."""
    turn = rotation_from_vector(pose.new_tensor((0.0, math.radians(degrees), 0.0)))
    return torch.cat((turn @ pose[:3], vector_from_rotation(turn @ rotation_from_vector(pose[3:6])), pose[6:]))


def _trace(model: HandModel, sign: str, joints: Float64[Tensor, "30"]) -> Float64[Tensor, "places 3"]:
    """Where the fingertip that draws a traced sign goes, as far as the hand starts where the sheet shows it."""
    poses = traced_poses(sign, joints, model, torch.linspace(0, 1, _TRACE_PLACES, dtype=torch.float64))
    tip = model.kinematics(dtype=torch.float64)(poses).keypoints[:, KEYPOINTS.index(TRACERS[sign])]
    start = model.kinematics(dtype=torch.float64)(standing_pose(sign, joints, model)).keypoints
    return tip + (start[KEYPOINTS.index(TRACERS[sign])] - tip[0])
