"""Render a seeded sequence of a moving hand with exact truth."""

import re
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import torch
from torch import Tensor
from tqdm import tqdm
from tyro.conf import arg

import torchhand
from torchhand.cli.command import DONE, command, parse, threads
from torchhand.errors import InputError
from torchhand.files import load_cameras, load_hand, load_hand_model
from torchhand.geometry import Camera, assumed_camera
from torchhand.hand import ShapeSpace, Side
from torchhand.hand.hand import Hand
from torchhand.hand.model import HandModel
from torchhand.simulate import (
    SceneSettings,
    check_sequence_folder,
    recorded_motion,
    render_sequence,
    sample_shape,
    scripted_motion,
    write_sequence,
)
from torchhand.study import flexion_deg

SMALLEST_PX, LARGEST_PX = 16, 8192


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Render a seeded sequence of a moving hand with exact truth.

    DIR gets frames/, masks/ (exact, without the forearm), cameras.json, truth.npz, about.json, and video.mp4 if asked
    for. The same arguments give the same pictures.

    Example:
        torchhand simulate --out out/planar --motion planar --frames 100 --background dark --seed 1
    """

    out: Annotated[Path, arg(metavar="DIR")]
    """Folder for the sequence."""
    motion: Literal["planar", "planar_point", "abduction", "flexion", "free", "wave", "leave"] = "planar"
    """What the hand does."""
    recorded: Annotated[Path | None, arg(metavar="FILE")] = None
    """Recorded joint angles of a sensing glove to play instead, with a small planar motion on top."""
    recorded_start: float = 0.0
    """Where in the recording to start, seconds."""
    frames: int = 100
    """Number of pictures."""
    fps: float = 30.0
    """Frames per second."""
    pace: float = 1.0
    """Factor on the speed of the motion."""
    size: Annotated[str, arg(metavar="WxH")] = "360x288"
    """Size of the pictures, px."""
    fov_deg: float = 48.0
    """Horizontal field of view, degrees."""
    camera: Annotated[Path | None, arg(metavar="FILE")] = None
    """Calibrated camera (cameras.json with one entry) instead of --size and --fov-deg."""
    view: Literal["back", "palm"] = "back"
    """Side of the hand that faces the camera at the start."""
    side: Literal["left", "right"] | None = None
    """Which hand; right, or that of --hand."""
    hand: Annotated[Path | None, arg(metavar="FILE")] = None
    """Shape of the hand (hand.json)."""
    random_hand: bool = False
    """Another person's hand for every seed."""
    surface: Literal["primitives", "mesh"] = "primitives"
    """What is drawn of the hand: its 37 quadrics, or its skin."""
    background: Literal["plain", "dark", "wall", "clutter"] = "plain"
    """What is behind the hand."""
    skin: Literal["light", "medium", "brown", "dark"] = "light"
    """Colour of the skin."""
    forearm: bool = False
    """Show a bare forearm."""
    noise: float = 2.0
    """Standard deviation of the sensor's noise, grey levels of 255."""
    blur_px: float = 0.0
    """Standard deviation of the lens's blur, px."""
    shutter: float = 0.0
    """Motion blur: share of the time between two frames in which the shutter is open, 0 to 1."""
    seed: int = 0
    """Seed of everything that is random."""
    pictures: Literal["jpg", "png"] = "jpg"
    """Format of the pictures."""
    video: bool = False
    """Write video.mp4 as well."""
    overwrite: bool = False
    """Replace an older sequence in DIR."""
    threads: int = 1
    """Threads of the renderer; small pictures are slower with more than one."""

    def __post_init__(self) -> None:
        if not 1 <= self.frames <= 100_000:
            raise ValueError(f"--frames: expected 1 to 100000, got {self.frames}")
        for name, low, high in (("fps", 0.1, 1000), ("pace", 0, 20), ("fov_deg", 5, 150), ("recorded_start", 0, 1e6)):
            if not low <= getattr(self, name) <= high:
                option = "--" + name.replace("_", "-")
                raise ValueError(f"{option}: expected {low:g} to {high:g}, got {getattr(self, name)}")
        if not -(2**63) <= self.seed < 2**63:
            raise ValueError(f"--seed: expected a number of 64 bits, got {self.seed}")
        if self.hand is not None and self.random_hand:
            raise ValueError("expected at most one of --hand and --random-hand, got both")

    @property
    def look(self) -> SceneSettings:
        return SceneSettings(
            surface=self.surface,
            background=self.background,
            skin=self.skin,
            noise=self.noise,
            blur_px=self.blur_px,
            shutter=self.shutter,
            forearm=self.forearm,
        )


@command
def main(argv: Sequence[str] | None = None) -> int:
    """Render one sequence into a folder."""
    arguments = parse(Arguments, argv, name="simulate")
    try:
        look = arguments.look
    except ValueError as error:
        raise InputError(str(error)) from error
    with threads(arguments.threads):
        _render(arguments, look)
    print(f"saved {arguments.frames} frames in {arguments.out}")
    return DONE


def _render(arguments: Arguments, look: SceneSettings) -> None:
    check_sequence_folder(arguments.out, overwrite=arguments.overwrite)
    model = load_hand_model()
    generator = torch.Generator().manual_seed(arguments.seed)
    side, shape = _hand(arguments, model.shape_space, generator)
    kinematics = model.kinematics(side, dtype=torch.float64)
    camera = _camera(arguments)
    if arguments.recorded is None:
        perform = partial(scripted_motion, arguments.motion)
    else:
        perform = partial(recorded_motion, arguments.recorded, start_s=arguments.recorded_start)
    motion = perform(
        arguments.frames,
        kinematics,
        camera,
        generator,
        shape=shape,
        view=arguments.view,
        fps=arguments.fps,
        pace=arguments.pace,
    )
    hand = _skinned(model, side) if arguments.surface == "mesh" else None
    rendered = render_sequence(kinematics, motion, camera, look, generator, shape=shape, hand=hand)
    given = {name: value for name, value in asdict(arguments).items() if name not in ("out", "overwrite", "threads")}
    about = {name: str(value) if isinstance(value, Path) else value for name, value in given.items()}
    write_sequence(
        arguments.out,
        iter(tqdm(rendered, total=arguments.frames, desc="rendering", unit="frame", disable=not sys.stderr.isatty())),
        motion,
        camera,
        kinematics,
        shape,
        picture_format=arguments.pictures,
        with_video=arguments.video,
        overwrite=arguments.overwrite,
        about={"torchhand": torchhand.__version__, "hand": side, "motion": motion.name, "arguments": about},
        measures={"flexion_deg": flexion_deg},
    )


def _skinned(model: HandModel, side: Side) -> Hand:
    if model.mesh is None:
        raise InputError(f"--surface mesh: the hand model {model.name!r} has no mesh (mesh.npz in its folder)")
    return model.hand(side=side, dtype=torch.float64)


def _hand(arguments: Arguments, space: ShapeSpace, generator: torch.Generator) -> tuple[Side, Tensor]:
    """Side and shape."""
    if arguments.hand is None:
        shape = sample_shape(space, generator) if arguments.random_hand else space.default
        return arguments.side or "right", shape
    fitted = load_hand(arguments.hand, space.names)
    for name, value, low, high in zip(space.names, fitted.values.values(), space.lower, space.upper, strict=True):
        if not low <= value <= high:
            allowed = f"{float(low):g} to {float(high):g}"
            raise InputError(f"{arguments.hand}: shape.{name}: expected {allowed}, got {value:g}")
    own_side: Side = "left" if fitted.side == "left" else "right"
    return arguments.side or own_side, torch.tensor(list(fitted.values.values()), dtype=torch.float64)


def _camera(arguments: Arguments) -> Camera:
    """The camera; the hand moves in its own frame, whatever place a file gives it."""
    if arguments.camera is not None:
        cameras = load_cameras(arguments.camera)
        if len(cameras) != 1:
            names = ", ".join(camera.name for camera in cameras)
            raise InputError(f"{arguments.camera}: expected one camera, got {len(cameras)} ({names})")
        place = {"rotation": torch.eye(3, dtype=torch.float64), "translation": torch.zeros(3, dtype=torch.float64)}
        return replace(cameras[0], **place)
    match = re.fullmatch(r"(\d{1,5})[xX](\d{1,5})", arguments.size)
    width, height = (int(match[1]), int(match[2])) if match else (0, 0)
    if not (SMALLEST_PX <= width <= LARGEST_PX and SMALLEST_PX <= height <= LARGEST_PX):
        raise InputError(
            f"--size: expected WIDTHxHEIGHT in px, each {SMALLEST_PX} to {LARGEST_PX}, like 360x288;"
            f" got {arguments.size!r}"
        )
    return replace(assumed_camera(width, height, horizontal_fov_deg=arguments.fov_deg), is_assumed=False)
