"""The evaluation of Ueda et al. 2003 again: figures 13 and 14, table 1, torques against least squares over cameras."""

import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import torch
from tqdm import tqdm
from tyro.conf import arg

import torchhand
from torchhand.cli.command import DONE, STOPPED_BY_USER, parse, threads
from torchhand.cli.simulations import rig_cameras
from torchhand.errors import InputError
from torchhand.files import check_output_folder, load_hand_model
from torchhand.fit.hull import HullTorqueSettings, TorqueSteps
from torchhand.runs import resume_option
from torchhand.study.ueda import (
    DEFAULT_STEPS,
    METHODS,
    RESULT_NAMES,
    BentCase,
    PartsFolder,
    converge,
    fit_errors,
    open_recording,
    own_bent,
    printed,
    recorded_bent,
    stage_times,
    subject,
    write_results,
)

UEDA = "ueda"
"""The word after `torchhand study` that asks for this study."""

_MAX_CAMERAS = 8
_TABLE_LEVEL = 7  # that of the table in Ueda et al. (2003)
_REPEATS = 5


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """The evaluation of Ueda et al. 2003 again, on simulated hands and on a recording.

    The index bent at its knuckle is fitted by torques (figures 13 and 14: error and share of vertices inside, iteration
    by iteration, over octree levels), stages are timed (table 1), and ways of fitting are compared over people and
    numbers of cameras, from guesses as a tracker has them. DIR gets convergence.csv, stages.csv, comparison.csv,
    figure13.png, figure14.png, comparison.png and parts.json (everything).

    Example:
        torchhand study ueda --out out/ueda
        torchhand study ueda --out out/ueda --data recordings/rig --people 2
    """

    out: Annotated[Path, arg(metavar="DIR")]
    """Folder for the results."""
    data: Annotated[Path | None, arg(metavar="RIG")] = None
    """Recording of several cameras with truth.npz, in which the index is bent while the palm stays: another hand than
    our own."""
    data_frames: tuple[int, int] = (0, 1)
    """Frames of the recording: one to fit the hand's shape on, and one to find the bent finger in."""
    side: Literal["left", "right"] = "right"
    """Which hand the recording shows."""
    levels: Annotated[str, arg(metavar="N,N-N")] = "6-8"
    """Levels of the octree."""
    angle_deg: float = 10.0
    """How far the simulated index is bent."""
    iterations: int = 20
    """Steps of the fit by torques."""
    rig: Annotated[str, arg(metavar="NAME|FILE")] = "frame"
    """Cameras of the simulated index, as of `torchhand simulate --rig`; frame3 are those of Ueda et al. (2003)."""
    people: int = 6
    """Random people that the ways of fitting are compared on; 0 leaves the comparison away."""
    cameras: Annotated[str, arg(metavar="N,N-N")] = "1-8"
    """Numbers of cameras in the comparison: the first so many of a frame of eight."""
    level: int = 7
    """Level of the octree in the comparison."""
    mask_noise: float = 1.0
    """Standard deviation by which the boundaries of the silhouettes are off in the comparison, px."""
    off_deg: float = 5.0
    """Standard deviation by which guesses are off, of every angle and of the palm's turn."""
    off_mm: float = 5.0
    """Standard deviation by which guesses of the palm's place are off."""
    seed: int = 0
    """Seed of everything that is random."""
    threads: int = 1
    """Threads that torch computes with."""
    resume: bool = False
    """Go on with an interrupted study."""
    overwrite: bool = False
    """Replace an older study in DIR."""

    def __post_init__(self) -> None:
        ranges = {"angle_deg": (0, 80), "iterations": (1, 1000), "people": (0, 1000), "level": (3, 9)}
        ranges |= {"mask_noise": (0, 20), "off_deg": (0, 45), "off_mm": (0, 100)}
        for name, (low, high) in ranges.items():
            if not low <= getattr(self, name) <= high:
                option = "--" + name.replace("_", "-")
                raise ValueError(f"{option}: expected {low:g} to {high:g}, got {getattr(self, name)}")
        if not -(2**63) <= self.seed < 2**63:
            raise ValueError(f"--seed: expected a number of 64 bits, got {self.seed}")


Part = Callable[[], dict[str, Any]]


def study_ueda(argv: Sequence[str]) -> int:
    """Run the study, or go on with it. Raises InputError as commands do."""
    arguments = parse(Arguments, argv, name=f"study {UEDA}")
    check_output_folder(arguments.out, resume=arguments.resume, overwrite=arguments.overwrite)
    with threads(arguments.threads):
        plan = _plan(arguments)
        folder = PartsFolder(arguments.out, _header(arguments), resume=arguments.resume, overwrite=arguments.overwrite)
        left = [name for name in plan if name not in folder.parts]
        try:
            for name in tqdm(left, desc="study", unit="part", disable=not sys.stderr.isatty(), leave=False):
                folder.save(name, plan[name]())
        except KeyboardInterrupt:
            option = resume_option(arguments.overwrite)
            print(f"torchhand study: stopped by Ctrl-C; the same command with {option} goes on", file=sys.stderr)
            return STOPPED_BY_USER
        parts = {name: folder.parts[name] for name in plan}
        with folder.finishing(RESULT_NAMES) as place:
            write_results(place, parts)
    print(printed(parts))
    print(f"saved in {arguments.out}")
    return DONE


def numbers_of(text: str, option: str, low: int, high: int) -> tuple[int, ...]:
    """Numbers of a text such as 1,4-6, increasing. Raises InputError for anything else, or numbers out of range."""
    numbers: set[int] = set()
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\d{1,3})(?:-(\d{1,3}))?\s*", part)
        first, last = (int(match[1]), int(match[2] or match[1])) if match else (high + 1, high + 1)
        if not low <= first <= last <= high:
            raise InputError(
                f"{option}: expected numbers from {low} to {high}, such as {low},{low + 1}-{high}; got {text!r}"
            )
        numbers.update(range(first, last + 1))
    return tuple(sorted(numbers))


def _header(arguments: Arguments) -> dict[str, Any]:
    """What must be equal in a study that is to be resumed."""
    given = {key: value for key, value in asdict(arguments).items() if key not in ("out", "resume", "overwrite")}
    given = {key: str(value) if isinstance(value, Path) else value for key, value in given.items()}
    return {"study": UEDA, "torchhand": torchhand.__version__, "torch": str(torch.__version__), **given}


def _plan(arguments: Arguments) -> dict[str, Part]:
    """The parts by name. What they need of pictures and fits is made when the first of them runs."""
    levels = numbers_of(arguments.levels, "--levels", 3, 9)
    counts = numbers_of(arguments.cameras, "--cameras", 1, _MAX_CAMERAS)
    cameras, model = rig_cameras(arguments.rig), load_hand_model()
    cases: dict[str, Callable[[], BentCase]] = {
        "own": lambda: own_bent(model, cameras, arguments.angle_deg, arguments.seed)
    }
    if arguments.data is not None:
        recording = open_recording(arguments.data, arguments.data_frames)
        cases["data"] = lambda: recorded_bent(model, recording, arguments.side)
    plan: dict[str, Part] = {}
    for source, make in cases.items():
        case = lru_cache(maxsize=1)(make)
        for steps in (DEFAULT_STEPS, *(name for name in get_args(TorqueSteps) if name != DEFAULT_STEPS)):
            for level in levels:
                plan[f"converge-{source}-{steps}-{level}"] = partial(
                    _converged,
                    case,
                    source,
                    level,
                    HullTorqueSettings(iterations=arguments.iterations, steps=steps, outside_fraction=0.0),
                )
        plan[f"stages-{source}"] = partial(_timed, case, source)
    eight = rig_cameras(f"frame{_MAX_CAMERAS}")
    seat = lru_cache(maxsize=1)(
        lambda number: subject(
            model,
            eight,
            number,
            arguments.seed,
            noise_px=arguments.mask_noise,
            off=(arguments.off_deg, arguments.off_mm),
        )
    )
    for number in range(arguments.people):
        for count in counts:
            plan[f"compare-{number}-{count}"] = partial(_compared, seat, number, count, arguments.level)
    return plan


def _converged(case: Callable[[], BentCase], source: str, level: int, settings: HullTorqueSettings) -> dict[str, Any]:
    found = asdict(converge(case().finger, level, settings))
    return {"kind": "converge", "source": source, "level": level, "steps": settings.steps, **found}


def _timed(case: Callable[[], BentCase], source: str) -> dict[str, Any]:
    times = stage_times(case().finger, case().pictures, _TABLE_LEVEL, _REPEATS)
    return {"kind": "stages", "source": source, "level": _TABLE_LEVEL, "ms": times}


def _compared(seat: Callable[[int], Any], number: int, count: int, level: int) -> dict[str, Any]:
    errors = {name: asdict(error) for name, error in fit_errors(seat(number), count, level, METHODS).items()}
    return {"kind": "compare", "person": number, "cameras": count, "errors": errors}
