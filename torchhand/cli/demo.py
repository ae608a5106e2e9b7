"""Simulate a short video of a hand in a room, track it, judge the result against the truth, and report."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Annotated, Any

import cv2
import torch
from jaxtyping import UInt8
from torch import Tensor
from tqdm import tqdm
from tyro.conf import arg

import torchhand
from torchhand.cli.command import DONE, command, parse, threads
from torchhand.draw import contact_sheet
from torchhand.evaluate import evaluate, flexion_deg, load_truth, tracked_silhouettes
from torchhand.files import Track, check_output_folder, load_hand_model
from torchhand.files.disk import replacing
from torchhand.files.results import REPORT_NAME
from torchhand.geometry import assumed_camera
from torchhand.runs import Request, overlay_frames, settings_of, track_sequence
from torchhand.simulate import (
    MovingHand,
    SceneSettings,
    SequenceFolder,
    check_sequence_folder,
    render_sequence,
    scripted_motion,
    write_sequence,
)
from torchhand.view import HandProjector

CONFIG = "contour_full"
CHANGES = ("update.passes=1",)
"""One update a frame: fast enough to follow a camera."""
SIZE_PX = (480, 360)
FOV_DEG = 48.0
SCENE = SceneSettings(surface="mesh", background="room", forearm=True, noise=3.0, blur_px=0.5, supersampling=2)
PICTURES = 4  # on the contact sheet
SIMULATED_NAME, TRACK_NAME, PICTURE_NAME = "simulated", "track", "picture.png"


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Simulate a short video of a hand in a room, track it, judge the result against the truth, and report.

    The hand is drawn, no recording: its skin, a forearm and a room behind it, with the noise of a camera. It is tracked
    as a webcam's, every frame from earlier ones alone. DIR gets simulated/ (pictures, camera and truth), track/ (the
    result, with report.html to open in a browser) and picture.png (frames of the overlay).

    Example:
        torchhand demo --out demo_out
    """

    out: Annotated[Path, arg(metavar="DIR")]
    """Folder for everything."""
    frames: int = 75
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
        print(f"a hand in a room: {arguments.frames} pictures of {SIZE_PX[0]}x{SIZE_PX[1]} in {simulated}")
        request = Request(
            settings=settings_of(CONFIG, CHANGES),
            config=CONFIG,
            side="right",
            camera=simulated / "cameras.json",
            is_causal=True,
            overwrite=arguments.overwrite,
            seed=arguments.seed,
        )
        track, projector = track_sequence(simulated / "frames", tracked, request, _say)
        print(_summary(track, evaluate(track, load_truth(simulated), tracked_silhouettes(track, projector))))
        _write_picture(arguments.out / PICTURE_NAME, _sheet(track, projector, simulated / "frames"))
    print(f"open {tracked / REPORT_NAME} in a browser: the video, the hand in 3D, every joint angle over time")
    return DONE


def _summary(track: Track, figures: dict[str, Any]) -> str:
    """What was found, for people who see such figures for the first time."""
    first, *others = (float(seconds) for seconds in track.seconds)
    followed, frames = figures["tracking"]["followed"], figures["tracking"]["frames"]
    a_frame = median(others)
    lines = [
        f"followed in {followed} of {frames} frames, {1 / a_frame:.0f} a second on one core "
        f"({1e3 * a_frame:.0f} ms each; the first, where the hand is found and measured, {first:.1f} s)",
        f"joints are {figures['position_2d_px']['mean']:.1f} px from the truth in the picture, and in space "
        f"{figures['position_mm']['aligned']['mean']:.1f} mm where size, place and turn of the hand are left out",
    ]
    if "silhouette" in figures:
        lines.append(f"the silhouettes overlap with the true ones to {figures['silhouette']['median_iou']:.0%}")
    if "uncertainty" in figures:
        joints = figures["uncertainty"]["by_joint"].values()
        inside = sum(one["fraction_in_95_percent_band"] for one in joints) / len(joints)
        lines.append(f"{inside:.0%} of the joints lie where the tracker is 95 % sure that they are")
    return "\n".join(lines)


def _simulate(folder: Path, arguments: Arguments) -> None:
    """The skin of a hand that is held up to a camera, before a room."""
    model = load_hand_model()
    kinematics = model.kinematics(dtype=torch.float64)
    hand = model.hand(side="right", dtype=torch.float64)
    shape = model.shape_space.default
    camera = replace(assumed_camera(*SIZE_PX, horizontal_fov_deg=FOV_DEG), is_assumed=False)
    generator = torch.Generator().manual_seed(arguments.seed)
    motion = scripted_motion("greet", arguments.frames, kinematics, camera, generator, shape=shape)
    rendered = render_sequence(kinematics, motion, camera, SCENE, generator, shape=shape, hand=hand)
    write_sequence(
        SequenceFolder(path=folder, overwrite=arguments.overwrite),
        iter(tqdm(rendered, total=arguments.frames, desc="rendering", unit="frame", disable=not sys.stderr.isatty())),
        MovingHand(kinematics=kinematics, shape=shape, motion=motion),
        camera,
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
