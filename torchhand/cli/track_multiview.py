"""Track a hand through the synchronised pictures of several calibrated cameras."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tqdm import tqdm
from tyro.conf import Positional, UseAppendAction, arg

from torchhand.cli.command import DONE, STOPPED_BY_USER, OnDevice, command, parse, threads, workers_of
from torchhand.devices import device_named
from torchhand.errors import InputError
from torchhand.files import offsets_of
from torchhand.files.pictures import MAX_MEGAPIXELS, pixel_limit
from torchhand.runs import (
    Request,
    how_to_go_on,
    keypoints_of,
    known_hand,
    settings_of,
    summary_of,
    track_live_rig,
    track_rig,
    without_hand,
)
from torchhand.track import TrackerSettings


@dataclass(frozen=True, kw_only=True)
class Arguments(OnDevice):
    """Track a hand through the synchronised pictures of several calibrated cameras.

    RIG holds cameras.json (or OpenCV's, COLMAP's or plain text files) and, per camera in its order, view_K/ with
    pictures, or NAME.mp4; masks_K/ may hold silhouettes. DIR gets report.html, which opens in a browser, track.npz,
    track.jsonl with header.json, hand.json, config.yaml and overlay.mp4, poses in the rig's world frame. The hand is
    found by itself in any posture, and its proportions are fitted once to frames from all over the sequence before it
    is followed.

    Example:
        torchhand track_multiview recording --out out/recording --side left
        torchhand track_multiview cameras.json --live 0,1,2 --out out/live
    """

    rig: Annotated[Positional[Path], arg(metavar="RIG")]
    """Folder of the cameras and their pictures."""
    out: Annotated[Path, arg(metavar="DIR")]
    """Folder for the results."""
    config: Annotated[str, arg(metavar="NAME")] = "hull_lm"
    """Method: hull_lm (least squares, both sides of skin and hull), hull_torque (Ueda et al. 2003 as printed), or a
    YAML file."""
    live: Annotated[str | None, arg(metavar="A,B,...")] = None
    """Cameras that are watched while they take pictures, in the order of RIG's cameras: numbers of webcams, or video
    files that are played as if live. RIG is then the folder or the file of the calibration alone. Late pictures are
    dropped and counted; the end is that of the last camera, or Ctrl-C."""
    cameras: Annotated[Path | None, arg(metavar="FILE")] = None
    """Cameras in another place than RIG."""
    unit: Annotated[str | None, arg(metavar="UNIT")] = None
    """Unit of the cameras' translations: m, cm, mm, inch, a number of metres, or `hand`: not known, and to be fitted so
    that the hand has its size (that of --hand, or the average)."""
    silhouettes: Literal["auto", "masks", "skin", "background", "chroma"] = "auto"
    """Source of the silhouettes: masks_K/ of RIG, colour of skin, difference from --background, or a coloured screen.
    auto: masks where RIG holds them, else as the configuration says."""
    background: Annotated[Path | None, arg(metavar="DIR")] = None
    """Pictures of the scene without the hand, one per camera: NAME.png or view_K.png."""
    hand: Annotated[Path | None, arg(metavar="FILE")] = None
    """Known shape of the hand (hand.json), which is then not fitted."""
    side: Literal["left", "right"] | None = None
    """Which hand. Without it, that of --hand; else the one that detected keypoints tell of; else, where the
    unit is known, the one whose hands explain three frames better; else right."""
    keypoints: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="mediapipe|FILE")] = ()
    """Detected keypoints that are used beside the silhouettes. mediapipe: MediaPipe runs along before every camera (pip
    install torchhand[mediapipe]), and what it finds is kept in DIR/keypoints_0.npz and so on. FILE: those that were
    found in the pictures of one camera, in the cameras' order; to be given for each."""
    hand_model: Annotated[Path | None, arg(metavar="FILE")] = None
    """hand_landmarker.task for a MediaPipe that carries no models of its own (newer than 0.10.21)."""
    offset: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="NAME=FRAMES|SECONDSs")] = ()
    """A camera that started so many frames before the others, or seconds, as in cam1=0.12s; may be repeated. Videos of
    different or varying rates, and all with an offset in seconds, are paired by their times."""
    causal: bool = False
    """Estimate every frame from this and earlier ones alone. Else frames are estimated again by what comes after."""
    start: Annotated[int, arg(metavar="N")] = 0
    """First frame, counted from 0."""
    max_frames: Annotated[int | None, arg(metavar="N")] = None
    """Frames to track at most."""
    resume: bool = False
    """Go on with an interrupted run; a finished one has nothing left to do."""
    overwrite: bool = False
    """Replace an older result in DIR."""
    keep_checkpoint: bool = False
    """Keep checkpoint.pt when the run has ended, for --resume with a larger --max-frames."""
    overlay: bool = True
    """Draw overlay.mp4."""
    report: bool = True
    """Write report.html: one page with the video, the hand in 3D, every angle over time and tables."""
    changes: Annotated[UseAppendAction[tuple[str, ...]], arg(name="set", metavar="KEY=VALUE")] = ()
    """Change a single setting, such as rig.octree.level=8; may be repeated. config.yaml of a result lists them all."""
    threads: int = 1
    """Threads of torch; its tensors are small, and more than one is slower."""
    max_megapixels: float = MAX_MEGAPIXELS
    """Largest pictures that are read; what is larger by its header is refused before it is decoded."""

    def __post_init__(self) -> None:
        if self.start < 0:
            raise ValueError(f"--start: expected 0 or more, got {self.start}")
        if self.max_frames is not None and self.max_frames < 1:
            raise ValueError(f"--max-frames: expected 1 or more, got {self.max_frames}")


@command
def main(argv: Sequence[str] | None = None) -> int:
    """Track the hand through one recording."""
    arguments = parse(Arguments, argv, name="track_multiview", settings=_settings)
    request = _request(arguments)
    with threads(arguments.threads), pixel_limit(arguments.max_megapixels):
        try:
            if arguments.live is None:
                track = track_rig(arguments.rig, arguments.out, request, _say)
            else:
                track = track_live_rig(_sources(arguments.live), arguments.rig, arguments.out, request, _say)
        except KeyboardInterrupt:
            _say(how_to_go_on(arguments.out, overwrite=request.overwrite))
            return STOPPED_BY_USER
    print(summary_of(arguments.rig.name, track, arguments.out))
    line = without_hand(track, "look at the silhouettes, the cameras' unit and --side")
    if line is not None:
        _say(line)
    return DONE


def _request(arguments: Arguments) -> Request:
    hand = None if arguments.hand is None else known_hand(arguments.hand)
    return Request(
        settings=_settings(arguments),
        config=arguments.config,
        side=arguments.side,
        hand=hand,
        camera=arguments.cameras,
        **keypoints_of(arguments.keypoints, arguments.hand_model),
        unit=arguments.unit,
        masks={"auto": None, "masks": True}.get(arguments.silhouettes, False),
        background=arguments.background,
        offsets=offsets_of(arguments.offset),
        is_causal=arguments.causal,
        start=arguments.start,
        max_frames=arguments.max_frames,
        resume=arguments.resume,
        overwrite=arguments.overwrite,
        keeps_checkpoint=arguments.keep_checkpoint,
        has_overlay=arguments.overlay,
        has_report=arguments.report,
        workers=workers_of(None, arguments.threads),
        device=device_named(arguments.device),
    )


def _sources(text: str) -> list[str | Path]:
    """Numbers of webcams as texts, and files."""
    parts = [part.strip() for part in text.split(",")]
    if not all(parts):
        raise InputError(f"--live: expected numbers of webcams or video files, with commas between them, got {text!r}")
    return [part if part.isdecimal() else Path(part) for part in parts]


def _settings(arguments: Arguments) -> TrackerSettings:
    changes = arguments.changes
    if arguments.silhouettes not in ("auto", "masks"):
        if any(change.startswith("silhouette.method=") for change in changes):
            raise InputError("--set: expected each field once, got silhouette.method and --silhouettes")
        changes = (*changes, f"silhouette.method={arguments.silhouettes}")
    return settings_of(arguments.config, changes)


def _say(line: str) -> None:
    """One line on stderr, beside a progress bar that may run."""
    tqdm.write(f"torchhand track_multiview: {line}", file=sys.stderr)
