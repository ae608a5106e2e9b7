"""Write a tracked or fitted hand in other programs' formats: GLB, BVH, URDF, MJCF, X3D, BAP, OBJ and more."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import OmitArgPrefixes, Positional, arg

from torchhand.cli.command import DONE, command, parse, threads
from torchhand.errors import InputError
from torchhand.export import (
    MAX_GAP_S,
    Axes,
    ExportOptions,
    FormatName,
    MotionClip,
    Up,
    check_max_gap,
    format_of,
    load_clip,
    write,
)
from torchhand.files.disk import expanded
from torchhand.files.results import RESULT_NAMES
from torchhand.hand import Side

_MAX_NAMED = 3


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Write a tracked or fitted hand in other programs' formats.

    The ending of --to says which: .glb (skin and animation), .bvh, .urdf and .xml (MuJoCo) with a folder of link
    meshes, .obj and .ply (one file per frame), .mano.npz, .openxr.json, .keypoints.json/.npz and .csv (21 points),
    .joints.csv (a URDF's joints), .teleop.jsonl (points in the wrist's frame), angles.csv (every joint angle with its
    standard deviation, time and status), .bap (MPEG-4), .x3d (H-Anim), .thp (a pose stream of 1 to 3 kbit/s). A
    hand.json alone gives the open hand at rest. BVH, MANO, OpenXR, WebXR, BAP, .joints.csv and .thp are read too.

    Example:
        torchhand export out/clip --to hand.glb
    """

    result: Annotated[Positional[Path], arg(metavar="IN")]
    """Result folder of `torchhand track`, its track.npz or track.jsonl, that of `torchhand fit_pose` (one picture, or
    several fitted with one --hand), a hand.json, or a motion in one of the formats that are read."""
    to: Annotated[Path, arg(metavar="FILE")]
    """File to write."""
    format: FormatName | None = None
    """Format, where the ending leaves it open."""
    gaps: Literal["hold", "cut"] = "hold"
    """Lost frames: hold repeats the last pose before them (at the beginning the first after them), cut leaves them
    out."""
    frame: int | None = None
    """Only the frame of this number."""
    fps: float | None = None
    """Frames per second, evenly; else the track's own times."""
    hand: Annotated[Path | None, arg(metavar="FILE")] = None
    """Another hand.json than the one beside the track."""
    side: Side | None = None
    """Side of the hand, where a motion of another program does not tell it; what tells the other one is refused."""
    up: Up | None = None
    """Axis that points up in IN: -y of one camera's track, that of the rig's world for several. Else -y of tracks and
    .joints.csv, y of BVH, BAP and OpenXR, and what MANO's file or the stream says."""
    axes: Axes | None = None
    """Frame of what is written: camera (that of the track), y-up, z-up, wrist (the hand's own: x out of its back, y to
    the fingers, the wrist at the origin) or mano (the wrist's with MANO's axes); else each format's usual one. A URDF
    and angles.csv have none."""
    max_gap_s: float = MAX_GAP_S
    """bvh, bap, thp, which know one rate: a time without frames that is longer becomes so many seconds long, and a note
    tells it; the other formats keep the times."""
    options: OmitArgPrefixes[ExportOptions] = ExportOptions()  # noqa: RUF009 - frozen
    """Options that only some formats ask."""
    overwrite: bool = False
    """Replace files that exist."""

    def __post_init__(self) -> None:
        if self.fps is not None and not 0 < self.fps <= 1e6:
            raise ValueError(f"--fps: expected more than 0, 1e6 at most, got {self.fps:g}")
        check_max_gap(self.max_gap_s, "--max-gap-s")


@command
def main(argv: Sequence[str] | None = None) -> int:
    """Write one file, or one per frame."""
    arguments = parse(Arguments, argv, name="export")
    target = expanded(arguments.to)
    kind = format_of(target, arguments.format)
    if target.is_dir():
        raise InputError(f"--to: expected a file, got the folder {target}")
    if not target.absolute().parent.is_dir():
        raise InputError(f"--to: expected a file in an existing folder, got {target}")
    with threads(1):
        clip = load_clip(
            arguments.result,
            gaps=arguments.gaps,
            fps=arguments.fps,
            hand=arguments.hand,
            up=arguments.up,
            side=arguments.side,
        )
        clip = replace(clip, axes=arguments.axes, max_gap_s=arguments.max_gap_s)
        if arguments.frame is not None:
            clip = _only(arguments, clip)
        files = kind.files(clip, target)
        _check_free(arguments, files)
        notes = write(clip, target, kind.name, arguments.options)
    print(_summary(clip, kind.name, files))
    for note in (*clip.notes, *notes):
        print(f"note: {note}")
    return DONE


def _only(arguments: Arguments, clip: MotionClip) -> MotionClip:
    assert arguments.frame is not None
    try:
        return clip.only(arguments.frame)
    except ValueError as error:
        cut = " (lost frames are cut)" if arguments.gaps == "cut" else ""
        raise InputError(f"--{error}{cut}") from error


def _check_free(arguments: Arguments, files: Sequence[Path]) -> None:
    """Also of what is written beside --to."""
    result = expanded(arguments.result)
    folder = (result if result.is_dir() else result.parent).resolve()
    for file in files:
        if file.resolve().parent == folder and file.name in RESULT_NAMES:
            raise InputError(f"--to: expected a name other than those of the result, got {file}")
        if file.exists() and not arguments.overwrite:
            raise InputError(f"{file}: exists already; give another name, or --overwrite")


def _summary(clip: MotionClip, kind: str, files: Sequence[Path]) -> str:
    frames = f"{len(clip)} frames at {clip.fps:g} per second" if len(clip) > 1 else "one frame"
    held = f", {len(clip.held)} of them lost and held" if clip.held else ""
    named = ", ".join(map(str, files[:_MAX_NAMED])) + (f", … {files[-1]}" if len(files) > _MAX_NAMED else "")
    return f"{clip.side} hand, {frames}{held}; saved {kind}: {named}"
