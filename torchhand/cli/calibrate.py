"""Calibrate one camera or several from pictures of a printed board: cameras.json and a report."""

import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import cv2
import torch
from tqdm import tqdm
from tyro.conf import Positional, arg

from torchhand.calibration import (
    Board,
    BoardCorners,
    CameraViews,
    FrameIndex,
    QualityLimits,
    RigCalibration,
    calibrate_rig,
    calibration_table,
    check_board,
    draw_board,
    find_board,
    other_board,
    shortcomings,
)
from torchhand.cli.command import DONE, command, parse, threads
from torchhand.draw import write_report
from torchhand.errors import InputError
from torchhand.files import RigSource, offsets_of, save_cameras
from torchhand.files.disk import replacing
from torchhand.files.pictures import MAX_MEGAPIXELS, pixel_limit
from torchhand.files.rigs import open_uncalibrated

_VIDEO_FRAMES = 60  # frames searched in a video, unless --every says otherwise
_MAX_FRAMES = 80  # used; more only cost time
_MIN_PICTURES = 3  # pictures without which there is nothing to compute
_TRIED = 3  # pictures without the board that are searched for another one


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Calibrate one camera or several from pictures of a printed board: cameras.json and a report.

    INPUT is a folder with a folder of pictures per camera (view_0, view_1, ... or any names), or a video per camera;
    one folder of pictures or one video for a single camera. Pictures of the same number, or frames of the same number,
    show the board at the same time. Show the board to every camera ten times or more, near, tilted to all sides, over
    the whole picture, and often to two cameras at once. A calibration that is not good is refused with the reasons.

    Beside FILE a folder FILE_report gets one picture per camera and report.txt.

    Example:
        torchhand calibrate --print-board board.png --board charuco --squares 9x6
        torchhand calibrate recordings/board --board charuco --squares 9x6 --square-mm 25 --out cameras.json
    """

    input: Annotated[Positional[Path | None], arg(metavar="INPUT")] = None
    """Pictures or videos of the board."""
    out: Annotated[Path | None, arg(metavar="FILE")] = None
    """cameras.json to write."""
    board: Literal["chessboard", "charuco"] = "chessboard"
    """Kind of board; a ChArUco board may be hidden in part."""
    squares: Annotated[str, arg(metavar="COLUMNSxROWS")] = "9x6"
    """Squares of the board, not inner corners."""
    square_mm: Annotated[float, arg(metavar="MM")] = 25.0
    """Side of a square as printed: measure it."""
    marker_mm: Annotated[float | None, arg(metavar="MM")] = None
    """Side of a ChArUco marker; three quarters of the square if not given."""
    dictionary: str = "DICT_4X4_50"
    """Markers of the ChArUco board, by OpenCV's name."""
    distortion: Literal[0, 4, 5, 8] = 5
    """Number of lens distortion coefficients, in OpenCV's order."""
    offset: Annotated[tuple[str, ...], arg(metavar="NAME=FRAMES|SECONDSs")] = ()
    """Offset of cameras that do not start together: this camera's picture number FRAMES belongs to number 0 of the
    others. Or seconds, as in cam1=0.12s, with which videos are paired by their times."""
    every: Annotated[int | None, arg(metavar="N")] = None
    """Search every Nth frame only; for videos chosen so that about 60 are searched, if not given."""
    world: Literal["camera", "board"] = "camera"
    """Frame of the result: the first camera's, or the board's in one picture (x along rows, y down, z into it)."""
    world_picture: Annotated[int | None, arg(metavar="N")] = None
    """Number of the picture, counted from 0, with --world board; the first at which the board was seen if not given."""
    max_rms: Annotated[float, arg(metavar="PX")] = 1.0
    """Largest reprojection error of a good calibration."""
    force: bool = False
    """Write a calibration that is not good all the same."""
    overwrite: bool = False
    """Replace older results."""
    print_board: Annotated[Path | None, arg(metavar="FILE")] = None
    """Only write a picture of the board to print (png), and stop."""
    threads: int = 1
    """Threads of the computation."""
    max_megapixels: float = MAX_MEGAPIXELS
    """Largest pictures that are read; what is larger by its header is refused before it is decoded."""

    def __post_init__(self) -> None:
        if not re.fullmatch(r"\d{1,3}x\d{1,3}", self.squares.lower()):
            raise ValueError(f"--squares: expected COLUMNSxROWS such as 9x6, got {self.squares!r}")
        if not 1 <= self.square_mm <= 1000:
            raise ValueError(f"--square-mm: expected 1 to 1000, got {self.square_mm:g}")
        if self.marker_mm is not None and not 0 < self.marker_mm < self.square_mm:
            raise ValueError(f"--marker-mm: expected more than 0, less than the square, got {self.marker_mm:g}")
        if self.every is not None and self.every < 1:
            raise ValueError(f"--every: expected 1 or more, got {self.every}")
        if not 0 < self.max_rms < 100:
            raise ValueError(f"--max-rms: expected above 0, below 100 px, got {self.max_rms:g}")
        if self.world_picture is not None and self.world != "board":
            raise ValueError("--world-picture: expected --world board with it")
        if self.print_board is None and (self.input is None or self.out is None):
            raise ValueError("expected INPUT and --out FILE, or --print-board FILE")


@command
def main(argv: Sequence[str] | None = None) -> int:
    """Find the board, calibrate, judge, write."""
    arguments = parse(Arguments, argv, name="calibrate")
    board = _board(arguments)
    if arguments.print_board is not None:
        return _print(arguments.print_board, board, overwrite=arguments.overwrite)
    assert arguments.input is not None
    assert arguments.out is not None
    report = arguments.out.with_name(f"{arguments.out.stem}_report")
    _check_outputs(arguments.out, report, overwrite=arguments.overwrite)
    with threads(arguments.threads), pixel_limit(arguments.max_megapixels):
        views = _views(arguments, arguments.input, board)
        found = calibrate_rig(views, board, distortion=arguments.distortion)
        if arguments.world == "board":
            frame = arguments.world_picture
            found = found.in_world_of_board(min(found.world_from_board) if frame is None else frame)
    table = calibration_table(found)
    print(table)
    lacks = shortcomings(found, replace(QualityLimits(), rms_px=arguments.max_rms))
    if lacks and not arguments.force:
        raise InputError(f"the calibration is not good, nothing was written (--force writes it): {'; '.join(lacks)}")
    for line in lacks:
        print(f"warning: {line}")
    _save(arguments.out, report, found, table, lacks)
    print(f"saved {arguments.out}; look at {report}")
    return DONE


def _board(arguments: Arguments) -> Board:
    columns, rows = map(int, arguments.squares.lower().split("x"))
    marker = 0.75 if arguments.marker_mm is None else arguments.marker_mm / arguments.square_mm
    try:
        return Board(
            kind=arguments.board,
            columns=columns,
            rows=rows,
            square=arguments.square_mm / 1000,
            marker=marker,
            dictionary=arguments.dictionary,
        )
    except ValueError as error:
        raise InputError(f"--squares, --board: {error}") from error


def _print(path: Path, board: Board, *, overwrite: bool) -> int:
    if path.suffix.lower() != ".png":
        raise InputError(f"--print-board: expected a name that ends in .png, got {path}")
    if path.exists() and not overwrite:
        raise InputError(f"{path}: exists already; give another name, or --overwrite")
    if not path.parent.is_dir():
        raise InputError(f"--print-board: expected a file in an existing folder, got {path}")
    _, encoded = cv2.imencode(".png", draw_board(board).numpy())
    with replacing(path) as temporary:
        temporary.write_bytes(encoded.tobytes())
    print(
        f"saved {path}: {board.columns}x{board.rows} squares; print it, measure a square, and glue it on something flat"
    )
    return DONE


def _check_outputs(out: Path, report: Path, *, overwrite: bool) -> None:
    if out.is_dir():
        raise InputError(f"--out: expected a file, got the folder {out}")
    if not out.parent.is_dir():
        raise InputError(f"--out: expected a file in an existing folder, got {out}")
    for path in (out, report):
        if path.exists() and not overwrite:
            raise InputError(f"{path}: exists already; give another name, or --overwrite")
    if report.exists() and not report.is_dir():
        raise InputError(f"{report}: expected a folder for the report, got a file")


def _views(arguments: Arguments, folder: Path, board: Board) -> list[CameraViews]:
    """The board's corners in all pictures. Raises InputError where a camera never saw it, and tells what it saw."""
    offsets = offsets_of(arguments.offset)
    with open_uncalibrated(folder, offsets=offsets) as whole:
        check_board(board, len(whole.names))
        count, has_videos = whole.count, whole.has_videos
    every = arguments.every or (max(1, (count or 0) // _VIDEO_FRAMES) if has_videos else 1)
    with open_uncalibrated(folder, offsets=offsets, every=every) as source:
        corners, others = _search(source, board)
        for line in source.warnings:
            print(f"note: {line}", file=sys.stderr)
        views = [
            CameraViews(name=name, width=size[0], height=size[1], corners=found)
            for name, size, found in zip(source.names, source.sizes, corners, strict=True)
        ]
    for view, other in zip(views, others, strict=True):
        if len(view.corners) < _MIN_PICTURES:
            what = f"a {board.kind} of {board.columns}x{board.rows} squares"
            hint = f"its pictures show {other}" if other else "check the pictures, --board and --squares"
            raise InputError(
                f"{view.name}: expected {what} in {QualityLimits().boards} pictures or more, found it in"
                f" {len(view.corners)}; {hint}"
            )
    return _fewer(views)


def _search(source: RigSource, board: Board) -> tuple[list[dict[FrameIndex, BoardCorners]], list[str | None]]:
    """Corners by frame for every view, and what else the first pictures without the board show."""
    corners: list[dict[FrameIndex, BoardCorners]] = [{} for _ in source.names]
    others: list[str | None] = [None] * len(corners)
    tried = [0] * len(corners)
    progress = tqdm(source, total=source.count, desc="finding the board", disable=not sys.stderr.isatty())
    for frame in progress:
        for i, image in enumerate(frame.images):
            found = None if image is None else find_board(image, board)
            if found is not None:
                corners[i][frame.index] = found
            elif image is not None and not corners[i] and others[i] is None and tried[i] < _TRIED:
                tried[i] += 1
                others[i] = other_board(image, board)
    return corners, others


def _fewer(views: list[CameraViews]) -> list[CameraViews]:
    """At most `_MAX_FRAMES` frames, evenly spread, those that several cameras share before the others."""
    frames = sorted({frame for view in views for frame in view.corners})
    if len(frames) <= _MAX_FRAMES:
        return views
    shared = [frame for frame in frames if sum(frame in view.corners for view in views) > 1]
    rest = [frame for frame in frames if frame not in set(shared)]
    kept = set(_spread(shared, _MAX_FRAMES))
    kept |= set(_spread(rest, _MAX_FRAMES - len(kept)))
    return [view.without(set(view.corners) - kept) for view in views]


def _spread(frames: list[FrameIndex], count: int) -> list[FrameIndex]:
    if count < 1 or len(frames) <= count:
        return frames[: max(count, 0)]
    return [frames[i] for i in torch.linspace(0, len(frames) - 1, count).round().long().tolist()]


def _save(out: Path, report: Path, found: RigCalibration, table: str, lacks: list[str]) -> None:
    write_report(report, found, table, lacks)
    save_cameras(list(found.cameras), out)
