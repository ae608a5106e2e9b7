"""Studies that people design themselves: factors, a design, and what becomes of registration in every cell."""

import contextlib
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from torchhand.cli.command import DONE, STOPPED_BY_USER, one_address, parse, threads
from torchhand.cluster import Cluster
from torchhand.devices import device_named
from torchhand.errors import InputError
from torchhand.files import check_output_folder, configs_dir
from torchhand.runs import resume_option
from torchhand.study.designed import load_study, printed_table, run_study

DESIGN = "design"
"""The word after `torchhand study` that asks for a study of one's own design."""

_FOLDER = "studies"


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Run a study of your own design on simulated hands: factors, a design, trials, all in one YAML file.

    STUDY is that file, or the name of a shipped one: observations, hypotheses, calibration. Every cell of the design is
    tried on the same hands from starts of its own; DIR gets study.csv (a row per cell, with Wilson's intervals),
    study.png (success over every factor; extra `study`), hypotheses.npz (every start, and the cells). The same study
    gives the same files, stopped and resumed or not.

    Example:
        torchhand study design observations --out out/observations
        torchhand study design my_study.yaml --out out/mine --trials 200 --pictures 50
    """

    study: Annotated[Positional[str], arg(metavar="STUDY")]
    """YAML file, or the name of a shipped study."""
    out: Annotated[Path, arg(metavar="DIR")]
    """Folder for the results."""
    trials: Annotated[int | None, arg(metavar="N")] = None
    """Trials of every cell, in place of those of the file."""
    pictures: Annotated[int | None, arg(metavar="N")] = None
    """Simulated hands, in place of those of the file."""
    seed: Annotated[int | None, arg(metavar="N")] = None
    """Seed of everything that is random, in place of that of the file."""
    device: str = "cpu"
    """Device of the registrations: cpu, or cuda. Hands, pictures and starts are the same on any."""
    threads: int = 1
    """Batches that are worked on side by side, on a core each. The results do not depend on it."""
    ray: Annotated[tuple[str, ...] | None, arg(metavar="[ADDRESS]")] = None
    """Work on the batches in the processes of a Ray cluster (extra `cluster`): of the one at ADDRESS, or, without one,
    of --threads processes on this machine. The results do not depend on it."""
    resume: bool = False
    """Go on with an interrupted study."""
    overwrite: bool = False
    """Replace an older study in DIR."""

    def __post_init__(self) -> None:
        one_address(self.ray)


def study_design(argv: Sequence[str]) -> int:
    """Run the study, or go on with it. Raises InputError as commands do."""
    arguments = parse(Arguments, argv, name=f"study {DESIGN}")
    check_output_folder(arguments.out, resume=arguments.resume, overwrite=arguments.overwrite)
    device_named(arguments.device)
    path = _file_of(arguments.study)
    changed = {
        name: value for name in ("trials", "pictures", "seed") if (value := getattr(arguments, name)) is not None
    }
    try:
        study = replace(load_study(path), **changed)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error
    try:
        with threads(arguments.threads), threads(1), _workers(arguments) as workers:
            found = run_study(
                study,
                arguments.out,
                workers=workers,
                device=arguments.device,
                resume=arguments.resume,
                overwrite=arguments.overwrite,
            )
    except KeyboardInterrupt:
        option = resume_option(arguments.overwrite)
        print(f"torchhand study: stopped by Ctrl-C; the same command with {option} goes on", file=sys.stderr)
        return STOPPED_BY_USER
    print(printed_table(study, found.rows))
    if found.seconds:
        print(f"{1e3 * found.seconds:.1f} ms per start, {len(found.hypotheses)} starts")
    print(f"saved in {arguments.out}" if found.seconds else f"finished already: {arguments.out}")
    return DONE


def _workers(arguments: Arguments) -> contextlib.AbstractContextManager[int | Cluster]:
    if arguments.ray is None:
        return contextlib.nullcontext(arguments.threads)
    return Cluster(one_address(arguments.ray), processes=arguments.threads)


def _file_of(name: str) -> Path:
    """The file of that name, or the shipped study."""
    if Path(name).is_file():
        return Path(name)
    shipped = {path.stem: path for path in sorted((configs_dir() / _FOLDER).glob("*.yaml"))}
    if name not in shipped:
        raise InputError(f"{name}: no such study; expected a YAML file or one of {', '.join(shipped) or 'none'}")
    return shipped[name]
