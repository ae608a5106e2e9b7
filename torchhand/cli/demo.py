"""Simulate a short video of a moving hand, track it, and judge the result against the truth."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import cv2
import torch
from jaxtyping import UInt8
from torch import Tensor
from tqdm import tqdm
from tyro.conf import arg

import torchhand
from torchhand.cli.command import DONE, command, parse, threads
from torchhand.cli.evaluate import table
from torchhand.draw import contact_sheet
from torchhand.evaluate import evaluate, flexion_deg, load_truth, tracked_silhouettes
from torchhand.files import Track, check_output_folder, load_hand_model
from torchhand.files.disk import replacing
from torchhand.geometry import assumed_camera
from torchhand.runs import Request, overlay_frames, settings_of, summary_of, track_sequence
from torchhand.simulate import SceneSettings, check_sequence_folder, render_sequence, scripted_motion, write_sequence
from torchhand.view import HandProjector

CONFIG = "contour_planar"
SIZE_PX = (360, 288)
FOV_DEG = 48.0
NOISE = 4.0
PICTURES = 4  # on the contact sheet
SIMULATED_NAME, TRACK_NAME, PICTURE_NAME = "simulated", "track", "picture.png"


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Simulate a short video of a moving hand, track it, and judge the result against the truth.

    DIR gets simulated/ (pictures, camera and truth), track/ (the result, with overlay.mp4) and picture.png (frames of
    the overlay). About half a minute.

    Example:
        torchhand demo --out demo_out
    """

    out: Annotated[Path, arg(metavar="DIR")]
    """Folder for everything."""
    frames: int = 60
    """Length of the video; 30 frames are a second."""
    overwrite: bool = False
    """Replace an older demo in DIR."""
    seed: int = 0
    """Seed of the motion and of the camera's noise."""

    def __post_init__(self) -> None:
        if not 2 <= self.frames <= 10_000:
            raise ValueError(f"--frames: expected 2 to 10000, got {self.frames}")
        if not -(2**63) <= self.seed < 2**63:
            raise ValueError(f"--seed: expected a number of 64 bits, got {self.seed}")


@command
def main(argv: Sequence[str] | None = None) -> int:
    """Simulate, track, judge, show."""
    arguments = parse(Arguments, argv, name="demo")
    simulated, tracked = arguments.out / SIMULATED_NAME, arguments.out / TRACK_NAME
    check_sequence_folder(simulated, overwrite=arguments.overwrite)
    check_output_folder(tracked, overwrite=arguments.overwrite)
    with threads(1):
        _simulate(simulated, arguments)
        request = Request(
            settings=settings_of(CONFIG),
            config=CONFIG,
            side="right",
            camera=simulated / "cameras.json",
            overwrite=arguments.overwrite,
            seed=arguments.seed,
        )
        track, projector = track_sequence(simulated / "frames", tracked, request, _say)
        print(summary_of("tracked", track, tracked))
        print(table(evaluate(track, load_truth(simulated), tracked_silhouettes(track, projector))))
        _write_picture(arguments.out / PICTURE_NAME, _sheet(track, projector, simulated / "frames"))
    print(f"look at {arguments.out / PICTURE_NAME} and {tracked / 'overlay.mp4'}")
    return DONE


def _simulate(folder: Path, arguments: Arguments) -> None:
    """An open hand that moves in the picture plane, before a plain wall."""
    model = load_hand_model()
    kinematics = model.kinematics(dtype=torch.float64)
    shape = model.shape_space.default
    camera = replace(assumed_camera(*SIZE_PX, horizontal_fov_deg=FOV_DEG), is_assumed=False)
    generator = torch.Generator().manual_seed(arguments.seed)
    motion = scripted_motion("planar", arguments.frames, kinematics, camera, generator, shape=shape)
    scene = SceneSettings(background="plain", noise=NOISE)
    rendered = render_sequence(kinematics, motion, camera, scene, generator, shape=shape)
    write_sequence(
        folder,
        iter(tqdm(rendered, total=arguments.frames, desc="rendering", unit="frame", disable=not sys.stderr.isatty())),
        motion,
        camera,
        kinematics,
        shape,
        overwrite=arguments.overwrite,
        about={"torchhand": torchhand.__version__, "made_by": "torchhand demo", "seed": arguments.seed},
        measures={"flexion_deg": flexion_deg},
    )


def _sheet(track: Track, projector: HandProjector, source: Path) -> UInt8[Tensor, "height width 3"]:
    """Some frames of the overlay, evenly spread over the sequence."""
    wanted = torch.linspace(0, len(track) - 1, min(PICTURES, len(track))).round().long().tolist()
    drawn = (picture for i, picture in enumerate(overlay_frames(track, projector, source)) if i in wanted)
    return contact_sheet(list(drawn), 2)


def _write_picture(path: Path, picture: UInt8[Tensor, "height width 3"]) -> None:
    _, encoded = cv2.imencode(path.suffix, cv2.cvtColor(picture.numpy(), cv2.COLOR_RGB2BGR))
    with replacing(path) as temporary:
        temporary.write_bytes(encoded.tobytes())


def _say(line: str) -> None:
    tqdm.write(f"torchhand demo: {line}", file=sys.stderr)
