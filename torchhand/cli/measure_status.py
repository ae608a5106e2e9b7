"""Measure how well a tracker tells its hand from another one or none; write the table of likelihood ratios."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from tqdm import tqdm
from tyro.conf import arg

import torchhand
from torchhand.cli.command import DONE, command, parse, threads
from torchhand.errors import InputError
from torchhand.files.disk import write_text
from torchhand.runs import settings_of
from torchhand.study.status import collect, derived_table
from torchhand.track import scene
from torchhand.track.scene import Health

_TABLE = Path(scene.__file__).with_name("status_rates.json")


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Measure how well a tracker tells its hand from another one or none; write the table of likelihood ratios.

    Simulated pictures show a hand, or things of its colours instead; the tracker's update rule starts beside the truth,
    from wrong hands, and where a search would. FILE gets this command and, for every configuration, how often its
    thresholds are wrong, and the likelihood ratio of right hands to all others with its thresholds at false-alarm rates
    and what these miss. The same arguments give the same table.

    Example:
        torchhand measure_status --out out/status_rates.json --pictures 400
    """

    out: Annotated[Path, arg(metavar="FILE")] = _TABLE
    """The table; that of the package if not given."""
    configs: Annotated[tuple[str, ...], arg(metavar="NAME")] = ("contour_full", "contour_planar", "distance_full")
    """Configurations of one camera to measure."""
    pictures: int = 120
    """Simulated hands per configuration."""
    seed: int = 0
    """Seed of everything that is random."""


@command
def main(argv: Sequence[str] | None = None) -> int:
    """Measure every configuration; the table is written at the end."""
    arguments = parse(Arguments, argv, name="measure_status")
    table: dict[str, Any] = {
        "command": f"torchhand measure_status --configs {' '.join(arguments.configs)} "
        f"--pictures {arguments.pictures} --seed {arguments.seed}",
        "version": torchhand.__version__,
    }
    with threads(1):
        for name in arguments.configs:
            settings = settings_of(name)
            samples = list(tqdm(collect(settings, arguments.pictures, arguments.seed), desc=name, disable=None))
            try:
                table[name] = derived_table(samples, Health(settings=settings.health))
            except ValueError as error:
                raise InputError(f"--pictures: {error}") from error
            print(f"{name}: {table[name]['health']}")
    write_text(arguments.out, json.dumps(table, indent=1) + "\n")
    print(f"saved {arguments.out}")
    return DONE
