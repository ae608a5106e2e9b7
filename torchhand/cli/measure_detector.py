"""Measure how far a detector's keypoints are from known hands; write the table of its errors."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

import torchhand
from torchhand.cli.command import DONE, command, parse, threads
from torchhand.errors import InputError
from torchhand.files.disk import write_text
from torchhand.fit import keypoints
from torchhand.study.detector import detector_errors, error_table, read_recordings

_TABLE = Path(keypoints.__file__).with_name("detector_errors.json")


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Measure how far a detector's keypoints are from known hands; write the table of its errors.

    Each SEQUENCE holds truth.npz (keypoints3d), cameras.json or one K per picture in truth.npz, and what the detector
    saw, mediapipe.npz or mediapipe_view_0.npz and so on. FILE gets the standard deviation of every point in the picture
    and its offset along the finger, the standard deviation of every angle that points in space tell, and how each
    recording looks by the table of all others.

    Example:
        torchhand measure_detector data/free data/flexion data/stills --out out/detector_errors.json
    """

    sequences: Annotated[Positional[tuple[Path, ...]], arg(metavar="SEQUENCE")]
    """Folders with truth and detections."""
    out: Annotated[Path, arg(metavar="FILE")] = _TABLE
    """The table; that of the package if not given."""


@command
def main(argv: Sequence[str] | None = None) -> int:
    """Measure every sequence; the table is written at the end."""
    arguments = parse(Arguments, argv, name="measure_detector")
    with threads(1):
        recordings = [one for folder in arguments.sequences for one in read_recordings(folder)]
        errors = [detector_errors(one) for one in recordings if len(one)]
    try:
        table = error_table(errors)
    except ValueError as error:
        raise InputError(f"SEQUENCE: {error}") from error
    names = " ".join(folder.name for folder in arguments.sequences)
    provenance = {"command": f"torchhand measure_detector {names}", "version": torchhand.__version__}
    write_text(arguments.out, json.dumps(provenance | table, indent=1) + "\n")
    for name, held_out in table["held_out"].items():
        points, angles = held_out["points"], held_out["angles"]
        print(f"{name}: {held_out['frames']} frames; by the others' table points {points:.2f} σ, angles {angles:.2f} σ")
    print(f"saved {arguments.out}")
    return DONE
