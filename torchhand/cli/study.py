"""Study how well registration recovers a hand: thousands of perturbed starts on pictures whose hand is known."""

import contextlib
import math
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from tqdm import tqdm
from tyro.conf import Positional, UseAppendAction, arg

from torchhand.cli.command import DONE, STOPPED_BY_USER, OnDevice, command, one_address, parse, threads
from torchhand.cli.studies import DESIGN, EXPORT, UEDA, study_design, study_export, study_ueda
from torchhand.cluster import Cluster, usable_cores
from torchhand.devices import device_named
from torchhand.errors import InputError
from torchhand.files import check_output_folder, load_hand_model, load_settings
from torchhand.fit import PostureResiduals
from torchhand.runs import changes_of, known_hand, resume_option
from torchhand.study.hypotheses import (
    CSV_NAME,
    NPZ_NAME,
    PICTURE_NAME,
    STATUS_NAMES,
    CaseStudy,
    Given,
    Hypotheses,
    HypothesisStudySettings,
    StudyFolder,
    SurfaceName,
    Work,
    cases_of,
    frames_of,
    printed_table,
    study_rows,
    with_iterations,
)

REFERENCE_STARTS = 16
"""Registrations of which the best is the reference of a picture without truth."""

_MAX_SIDE_BY_SIDE = 4  # unless the user wants more: each needs memory of its own
_GOOD_OVERLAP = 0.8  # of the reference hand and the mask, below which the user is told
_SMALLEST_PX = 64


@dataclass(frozen=True, kw_only=True)
class Arguments(OnDevice):
    """Study how well registration recovers a hand: thousands of perturbed starts on pictures whose hand is known.

    INPUT is a sequence with truth (of `torchhand simulate`, or frames/, cameras.json and truth.npz with keypoints3d); a
    picture, a folder of pictures or a video of an open hand, whose best registration is then the reference; or nothing:
    pictures of hands of our own are simulated. DIR gets study.csv (a row per size of the perturbation), study.png
    and hypotheses.npz (every start, and the settings). The same arguments give the same files, stopped and resumed or
    not.

    Example:
        torchhand study --out out/study --starts 10000
        torchhand study out/sequence --out out/study --frames 0,20,40 --surface mesh
        torchhand study ueda --help     (another study: hands fitted into hulls, Ueda et al. 2003)
        torchhand study design --help   (studies of your own design: factors, cells, outcomes)
        torchhand study export --help   (the starts of a finished study as a Parquet table)
    """

    input: Annotated[Positional[Path | None], arg(metavar="INPUT")] = None
    """Sequence with truth, or a picture or video; simulated pictures if not given."""
    out: Annotated[Path, arg(metavar="DIR")]
    """Folder for the results."""
    frames: Annotated[str, arg(metavar="N,N-N")] = "0"
    """Frames to study, from 0, such as 0 or 0,10,20-29, or all. Every number is another simulated picture."""
    config: Annotated[Path | None, arg(metavar="FILE")] = None
    """Settings (YAML), or hypotheses.npz of an earlier study, which holds its own; what follows changes single ones."""
    starts: Annotated[int | None, arg(metavar="N")] = None
    """Starts over all frames; 10000 if not given."""
    levels: Annotated[int | None, arg(metavar="N")] = None
    """Sizes of the perturbation, from the largest down; 5 if not given."""
    angle_deg: Annotated[float | None, arg(metavar="DEG")] = None
    """Largest perturbation of every joint angle, either way; 15 if not given."""
    translation_mm: Annotated[float | None, arg(metavar="MM")] = None
    """Largest perturbation of every coordinate of the wrist; 10 if not given."""
    rotation_deg: Annotated[float | None, arg(metavar="DEG")] = None
    """Largest perturbation of the hand's orientation, about any axis; 15 if not given."""
    iterations: Annotated[int | None, arg(metavar="N")] = None
    """Most iterations of a start, over all stages from coarse to fine; 20 if not given."""
    batch: Annotated[int | None, arg(metavar="N")] = None
    """Starts that are worked on together; 512 if not given."""
    surface: SurfaceName | None = None
    """Surface whose contours are registered (and drawn, of simulated pictures); primitives if not given."""
    method: Literal["levenberg_marquardt", "gauss_newton", "gradient_descent"] | None = None
    """Optimiser of every stage; levenberg_marquardt if not given. Gauss-Newton takes one step per association whatever
    --iterations says, gradient descent ten times the iterations."""
    space: Annotated[str | None, arg(metavar="NAME")] = None
    """Pose space: dof26 if not given, dof27, dof28, dof31, dof36 or planar_abduction."""
    prior: bool = True
    """Let the registration know which postures are likely."""
    start_prior: bool = True
    """Let the registration know how far starts may be off, as a tracker knows of its prediction."""
    success_deg: Annotated[float | None, arg(metavar="DEG")] = None
    """Largest mean error of the joint angles of a success; 5 if not given."""
    changes: Annotated[UseAppendAction[tuple[str, ...]], arg(name="set", metavar="KEY=VALUE")] = ()
    """Change any other setting, such as contour.coverage_weight=0; may be repeated."""
    camera: Annotated[Path | None, arg(metavar="FILE")] = None
    """Calibrated camera (cameras.json with one entry) of a picture; without it a field of view is assumed."""
    hand: Annotated[Path | None, arg(metavar="FILE")] = None
    """Known shape of the hand (hand.json); fitted to the picture or the truth's keypoints if not given."""
    side: Literal["left", "right"] | None = None
    """Which hand; that of the truth or of --hand, or right."""
    mask: Annotated[Path | None, arg(metavar="FILE")] = None
    """Silhouette of hand and forearm in a picture, bright inside."""
    size: Annotated[str, arg(metavar="WxH")] = "640x480"
    """Size of simulated pictures, px."""
    seed: int = 0
    """Seed of everything that is random."""
    threads: int | None = None
    """Batches that are worked on side by side, on a core each; as many as there are cores, at most 4, if not given. The
    results do not depend on it."""
    ray: Annotated[tuple[str, ...] | None, arg(metavar="[ADDRESS]")] = None
    """Work on the batches in the processes of a Ray cluster (extra `cluster`): of the one at ADDRESS, such as auto or
    HOST:6379, or, without one, of --threads processes on this machine, all its cores if not given. The results do not
    depend on it, and are the same bytes where the processors are of one kind."""
    resume: bool = False
    """Go on with an interrupted study."""
    overwrite: bool = False
    """Replace an older study in DIR."""

    def __post_init__(self) -> None:
        if not -(2**63) <= self.seed < 2**63:
            raise ValueError(f"--seed: expected a number of 64 bits, got {self.seed}")
        if one_address(self.ray) is not None and self.threads is not None:
            raise ValueError("--threads: expected none with an address of --ray, whose processors all work")


@command
def main(argv: Sequence[str] | None = None) -> int:
    """Run one study, or go on with it; the first words `ueda` and `design` ask for other studies."""
    words = sys.argv[1:] if argv is None else list(argv)
    if words[:1] == [UEDA]:
        return study_ueda(words[1:])
    if words[:1] == [DESIGN]:
        return study_design(words[1:])
    if words[:1] == [EXPORT]:
        return study_export(words[1:])
    arguments = parse(Arguments, argv, name="study", settings=_settings)
    settings = _settings(arguments)
    check_output_folder(arguments.out, resume=arguments.resume, overwrite=arguments.overwrite)
    side_by_side = arguments.threads
    if side_by_side is None:
        side_by_side = min(_MAX_SIDE_BY_SIDE, usable_cores())
    with (
        threads(side_by_side),  # for its check alone: each of them computes with one
        threads(1),
        _workers(arguments, side_by_side) as workers,
    ):
        work = _work(arguments, settings)
        folder = StudyFolder(arguments.out, work.header(), resume=arguments.resume, overwrite=arguments.overwrite)
        if folder.finished is not None:
            print(printed_table(study_rows(folder.finished, settings), settings))
            print(f"finished already: {arguments.out}")
            return DONE
        try:
            hypotheses, seconds = work.run(folder, workers)
        except KeyboardInterrupt:
            option = resume_option(arguments.overwrite)
            _say(f"stopped by Ctrl-C; the same command with {option} goes on from {folder.folder}")
            return STOPPED_BY_USER
        if not bool(hypotheses.is_registered.any()):
            folder.discard()
            raise InputError(f"{work.source}: all hypotheses failed ({_statuses(hypotheses)}); nothing is saved")
        rows = work.save(folder, hypotheses)
    print(printed_table(rows, settings))
    if seconds:
        print(f"{1e3 * seconds:.1f} ms per start; reference: {work.reference}")
    print(f"saved {CSV_NAME}, {PICTURE_NAME} and {NPZ_NAME} in {arguments.out}")
    return DONE


def _workers(arguments: Arguments, side_by_side: int) -> contextlib.AbstractContextManager[int | Cluster]:
    if arguments.ray is None:
        return contextlib.nullcontext(side_by_side)
    return Cluster(one_address(arguments.ray), processes=arguments.threads)


def _work(arguments: Arguments, settings: HypothesisStudySettings) -> Work:
    """The pictures and their hands. Raises InputError where they cannot be studied."""
    given = _given(arguments)
    device_named(arguments.device)
    _check_frames(len(given.frames or ()), settings)
    cases = cases_of(given, settings, arguments.seed)
    _check_frames(len(cases.cases), settings)
    source = "simulated pictures" if arguments.input is None else str(arguments.input)
    model, references, overlaps = load_hand_model(), [], []
    prior = PostureResiduals.of(model.prior().postures) if settings.has_prior else None
    for case in cases.cases:
        study = CaseStudy(case, model, settings, prior, arguments.device)
        is_empty = study.picture.is_empty
        if not cases.is_final and not is_empty:
            case = study.refined(REFERENCE_STARTS, arguments.seed)
            study = CaseStudy(case, model, settings, prior, arguments.device)
        references.append(study.case)
        overlaps.append(float("nan") if is_empty else study.overlap)
        if is_empty:
            _say(f"frame {case.frame}: its silhouette has no contour to register on")
        elif overlaps[-1] < _GOOD_OVERLAP:
            _say(f"frame {case.frame}: the reference hand covers the silhouette badly (overlap {overlaps[-1]:.2f})")
    if all(map(math.isnan, overlaps)):
        raise InputError(f"{source}: expected a silhouette with a contour to register on, got almost empty ones")
    return Work(
        settings=settings,
        cases=references,
        overlaps=overlaps,
        prior=prior,
        seed=arguments.seed,
        source=source,
        reference=cases.reference,
        device=arguments.device,
    )


def _check_frames(count: int, settings: HypothesisStudySettings) -> None:
    if count > settings.starts:
        raise InputError(f"--starts: expected {count} or more, one for each frame, got {settings.starts}")


def _settings(arguments: Arguments) -> HypothesisStudySettings:
    """Raises InputError naming the file or the option, and the key."""
    named = {
        **{name: name for name in ("starts", "batch", "surface", "space", "success_deg")},
        **{name: f"perturbation.{name}" for name in ("levels", "angle_deg", "translation_mm", "rotation_deg")},
    }
    given = {key: value for name, key in named.items() if (value := getattr(arguments, name)) is not None}
    given |= {f"has_{name}": False for name in ("prior", "start_prior") if not getattr(arguments, name)}
    changes = changes_of(arguments.changes, "contour.coverage_weight=0")
    settings = load_settings(HypothesisStudySettings(), arguments.config, changes)
    settings = load_settings(settings, None, given)
    schedule = settings.schedule
    if arguments.iterations is not None:
        try:
            schedule = with_iterations(schedule, arguments.iterations)
        except ValueError as error:
            raise InputError(f"--{error}") from error
    if arguments.method is not None:
        schedule = tuple(replace(stage, method=arguments.method) for stage in schedule)
    return replace(settings, schedule=schedule)


def _given(arguments: Arguments) -> Given:
    match = re.fullmatch(r"(\d{2,4})[xX](\d{2,4})", arguments.size)
    if match is None or min(int(match[1]), int(match[2])) < _SMALLEST_PX:
        raise InputError(
            f"--size: expected WIDTHxHEIGHT in px, each {_SMALLEST_PX} to 9999, like 640x480; got {arguments.size!r}"
        )
    return Given(
        source=arguments.input,
        frames=frames_of(arguments.frames),
        camera=arguments.camera,
        hand=None if arguments.hand is None else known_hand(arguments.hand),
        side=arguments.side,
        mask=arguments.mask,
        size=(int(match[1]), int(match[2])),
    )


def _statuses(hypotheses: Hypotheses) -> str:
    counts = {name: int((hypotheses.status == i).sum()) for i, name in enumerate(STATUS_NAMES)}
    return ", ".join(f"{count} {name}" for name, count in counts.items() if count)


def _say(line: str) -> None:
    tqdm.write(f"torchhand study: {line}", file=sys.stderr)
