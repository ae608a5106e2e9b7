"""Write a hand model's hand.urdf and mesh.npz from its shape.json and the anatomy, and pictures of them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import cv2
import torch
from jaxtyping import Float, UInt8
from torch import Tensor
from tqdm import tqdm
from tyro.conf import arg

from torchhand.cli.command import DONE, command, parse
from torchhand.errors import InputError
from torchhand.files.hand_model import read_shape_space
from torchhand.files.locations import models_dir
from torchhand.files.mesh_file import load_mesh, save_mesh
from torchhand.files.safe_write import replacing, write_text
from torchhand.files.urdf import read_skeleton, skeleton_to_urdf
from torchhand.geometry import assumed_camera, rotation_from_vector
from torchhand.hand import posture
from torchhand.hand.anatomy import anatomical_skeleton
from torchhand.hand.model import HandModel
from torchhand.hand.posed_mesh import posed_mesh
from torchhand.view import shade
from torchhand.view.surface import Surface, cast

PRIMITIVE_POSTURES = ("open", "fist", "point")
MESH_POSTURES = ("open", "fist", "pinch", "point")
_TILE_PX = 320
_FIELD_OF_VIEW_DEG = 22.0
_DISTANCE = 0.6  # metres

# Where the hand frame's x, y and z point in the camera's frame.
_PALM = ((0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (1.0, 0.0, 0.0))
_BACK = ((0.0, 0.0, -1.0), (0.0, -1.0, 0.0), (-1.0, 0.0, 0.0))
_THUMB_SIDE = ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0))
_LITTLE_SIDE = ((-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0))
_FINGERTIPS = ((0.0, 1.0, 0.0), (0.0, 0.0, -1.0), (-1.0, 0.0, 0.0))
_OBLIQUE_TURN = (0.5, 0.7, 0.0)  # rotation vector applied to the back view
_PAPER_GREY = 245


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Write a hand model's hand.urdf and mesh.npz from its shape.json and the anatomy, and pictures of them.

    The mesh takes a minute or two and needs `pip install torchhand[build]`.

    Example:
        torchhand build_hand --out models/generic_hand
    """

    out: Annotated[Path | None, arg(metavar="DIR")] = None
    """Model folder; it must hold shape.json. The shipped generic_hand if not given."""
    keep_mesh: bool = False
    """Leave mesh.npz as it is; everything else is written."""


@command
def main(argv: Sequence[str] | None = None) -> int:
    """Build one model folder."""
    arguments = parse(Arguments, argv, name="build_hand")
    folder = arguments.out or models_dir() / "generic_hand"
    if not (folder / "shape.json").is_file():
        raise InputError(f"{folder}: expected a model folder with shape.json; there is none")
    space = read_shape_space(folder / "shape.json")
    mesh_path = folder / "mesh.npz"
    if arguments.keep_mesh:
        mesh = load_mesh(mesh_path, shape_names=space.names)
    urdf = folder / "hand.urdf"
    write_text(urdf, skeleton_to_urdf(anatomical_skeleton(space), folder.resolve().name))
    print(f"saved {urdf}")
    model = HandModel(name=folder.name, skeleton=read_skeleton(urdf), shape_space=space)
    if not arguments.keep_mesh:
        _build(model, mesh_path)
        mesh = load_mesh(mesh_path, shape_names=space.names)
    model = replace(model, mesh=mesh)
    for name, picture in (("preview.png", primitive_preview(model)), ("mesh.png", mesh_preview(model))):
        with replacing(folder / name) as temporary:
            cv2.imwrite(str(temporary), cv2.cvtColor(picture.numpy(), cv2.COLOR_RGB2BGR))
        print(f"saved {folder / name}")
    return DONE


def _build(model: HandModel, path: Path) -> None:
    try:
        from torchhand.modelling.build import build_mesh, build_steps
    except ImportError as error:
        raise InputError(f"the mesh needs {error.name}: pip install torchhand[build] (or --keep-mesh)") from error
    with tqdm(total=build_steps(model), desc="mesh", disable=None) as bar:
        mesh = build_mesh(model, on_step=bar.update)
    save_mesh(mesh, path, shape_names=model.shape_space.names)
    print(f"saved {path}: {len(mesh.vertices)} vertices, {len(mesh.faces)} faces")


def primitive_preview(model: HandModel, *, tile_px: int = _TILE_PX) -> UInt8[Tensor, "height width 3"]:
    """The 37 quadrics: one row per posture; palm, back, thumb side and oblique in the columns."""
    return _sheet(model, PRIMITIVE_POSTURES, _views()[:4], tile_px, with_mesh=False)


def mesh_preview(model: HandModel, *, tile_px: int = _TILE_PX) -> UInt8[Tensor, "height width 3"]:
    """The mesh from six sides: palm, back, thumb side, oblique, little finger's side, fingertips."""
    return _sheet(model, MESH_POSTURES, _views(), tile_px, with_mesh=True)


def _views() -> list[Float[Tensor, "3 3"]]:
    palm, back, thumb, little, tips = (
        torch.tensor(axes, dtype=torch.float64).T for axes in (_PALM, _BACK, _THUMB_SIDE, _LITTLE_SIDE, _FINGERTIPS)
    )
    oblique = rotation_from_vector(torch.tensor(_OBLIQUE_TURN, dtype=torch.float64)) @ back
    return [palm, back, thumb, oblique, little, tips]


def _sheet(
    model: HandModel, postures: Sequence[str], views: list[Tensor], tile_px: int, *, with_mesh: bool
) -> UInt8[Tensor, "height width 3"]:
    hand = model.hand(dtype=torch.float64)
    camera = assumed_camera(tile_px, tile_px, horizontal_fov_deg=_FIELD_OF_VIEW_DEG)
    paper = torch.full((tile_px, tile_px, 3), _PAPER_GREY, dtype=torch.uint8)
    rows = []
    for name in postures:
        state = hand(posture(name))
        surface: Surface = posed_mesh(hand, state) if with_mesh else state.primitives
        middle = 0.5 * (state.keypoints.amin(0) + state.keypoints.amax(0))
        ahead = torch.tensor((0.0, 0.0, _DISTANCE), dtype=torch.float64)
        casts = [cast(surface.moved(view, ahead - view @ middle), camera) for view in views]
        rows.append(torch.cat([shade(seen, background=paper) for seen in casts], 1))
    return torch.cat(rows)
