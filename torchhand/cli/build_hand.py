"""Write a hand model's hand.urdf, skeleton.npz, mesh.npz and pictures from its shape.json and the anatomy."""

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
from torchhand.files import load_mesh, models_dir, save_mesh
from torchhand.files.disk import replacing, write_text
from torchhand.files.hands import read_shape_space, read_skeleton, save_parsed_skeleton, skeleton_to_urdf
from torchhand.geometry import assumed_camera, rotation_from_vector
from torchhand.hand import HandModel, HandState, posed_mesh, posture
from torchhand.hand.limits import anatomical_skeleton
from torchhand.view import Surface, cast, shade

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
_PRIOR_TURN = (0.35, -0.5, 0.0)  # applied to the view of the palm
_PAPER_GREY = 245


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Write a hand model's hand.urdf, skeleton.npz, mesh.npz and pictures from its shape.json and the anatomy.

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
    print(f"saved {save_parsed_skeleton(urdf)}")
    model = HandModel(name=folder.name, skeleton=read_skeleton(urdf), shape_space=space)
    if not arguments.keep_mesh:
        _build(model, mesh_path)
        mesh = load_mesh(mesh_path, shape_names=space.names)
    model = replace(model, mesh=mesh)
    pictures = {
        "preview.png": primitive_preview(model),
        "mesh.png": mesh_preview(model),
        "prior.png": prior_sheet(model),
        "palm.png": palm_picture(model),
    }
    for name, picture in pictures.items():
        with replacing(folder / name) as temporary:
            cv2.imwrite(str(temporary), cv2.cvtColor(picture.numpy(), cv2.COLOR_RGB2BGR))
        print(f"saved {folder / name}")
    return DONE


def _build(model: HandModel, path: Path) -> None:
    try:
        from torchhand.modelling import build_mesh, build_steps
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


def palm_picture(model: HandModel, *, tile_px: int = _TILE_PX) -> UInt8[Tensor, "height width 3"]:
    """The mesh of the open right hand from the palm: a picture that every detector of hands should know."""
    return _sheet(model, MESH_POSTURES[:1], _views()[:1], tile_px, with_mesh=True)


def prior_sheet(
    model: HandModel, *, tile_px: int = 128, rows: int = 8, columns: int = 8
) -> UInt8[Tensor, "height width 3"]:
    """Samples of the prior, people and postures, seen obliquely from the palm's side."""
    hand = model.hand(dtype=torch.float64)
    poses, shapes = model.prior(dtype=torch.float64).sample(rows * columns, torch.Generator().manual_seed(0))
    palm = torch.tensor(_PALM, dtype=torch.float64).T
    view = rotation_from_vector(torch.tensor(_PRIOR_TURN, dtype=torch.float64)) @ palm
    states = [hand(pose, shape) for pose, shape in zip(poses, shapes, strict=True)]
    tiles = [_tile(posed_mesh(hand, state), state, view, tile_px) for state in states]
    return torch.cat([torch.cat(tiles[i : i + columns], 1) for i in range(0, len(tiles), columns)])


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
    rows = []
    for name in postures:
        state = hand(posture(name, dtype=torch.float64))
        surface: Surface = posed_mesh(hand, state) if with_mesh else state.primitives
        rows.append(torch.cat([_tile(surface, state, view, tile_px) for view in views], 1))
    return torch.cat(rows)


def _tile(
    surface: Surface, state: HandState, view: Float[Tensor, "3 3"], tile_px: int
) -> UInt8[Tensor, "height width 3"]:
    """One hand in the middle of a tile; view: cam_from_hand."""
    camera = assumed_camera(tile_px, tile_px, horizontal_fov_deg=_FIELD_OF_VIEW_DEG)
    middle = 0.5 * (state.keypoints.amin(0) + state.keypoints.amax(0))
    ahead = torch.tensor((0.0, 0.0, _DISTANCE), dtype=torch.float64)
    seen = cast(surface.moved(view, ahead - view @ middle), camera)
    return shade(seen, background=torch.full((tile_px, tile_px, 3), _PAPER_GREY, dtype=torch.uint8))
