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
from torchhand.runs.pictures import single_pose_fitter
from torchhand.simulate import NO_HAND
from torchhand.study.status import Finder, collect, derived_table, first_frame, reported_hands
from torchhand.track import scene
from torchhand.track.scene import Health
from torchhand.track.single import SinglePoseSettings

_EMPTY = "pictures_without_hand"
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
    empty: int = 0
    """Pictures that show faces, portraits, arms, walls, tables, furniture, textures and other things but no hand: in
    how many a tracker's first frame and `fit_pose` report one is counted instead, and the rest of FILE kept; some
    seconds a picture."""
    seed: int = 0
    """Seed of everything that is random."""


@command
def main(argv: Sequence[str] | None = None) -> int:
    """Measure every configuration; the table is written at the end."""
    arguments = parse(Arguments, argv, name="measure_status")
    before: dict[str, Any] = json.loads(arguments.out.read_text(encoding="utf-8")) if arguments.out.is_file() else {}
    if arguments.empty:
        write_text(arguments.out, json.dumps(before | {_EMPTY: _empty(arguments)}, indent=1) + "\n")
        print(f"saved {arguments.out}")
        return DONE
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
    if _EMPTY in before:
        table[_EMPTY] = before[_EMPTY]
    write_text(arguments.out, json.dumps(table, indent=1) + "\n")
    print(f"saved {arguments.out}")
    return DONE


def _empty(arguments: Arguments) -> dict[str, Any]:
    """How many hands are reported where there is none."""
    fitter = single_pose_fitter("right", SinglePoseSettings())
    finders: dict[str, Finder] = {name: first_frame(settings_of(name)) for name in arguments.configs}
    finders["fit_pose"] = lambda view, camera: fitter(view, camera).estimate
    count, found = arguments.empty, {}
    with threads(1):
        for name, find in finders.items():
            hands = reported_hands(find, count, arguments.seed)
            seen = list(tqdm(hands, desc=name, total=count, unit="picture", disable=None))
            kinds = {kind: sum(one.is_reported for one in seen if one.kind == kind) for kind in NO_HAND}
            found[name] = {"reported": sum(kinds.values()), "by_kind": kinds}
            print(f"{name}: a hand in {found[name]['reported']} of {count} pictures without one")
    told = f"torchhand measure_status --configs {' '.join(arguments.configs)} --empty {count} --seed {arguments.seed}"
    return {"command": told, "version": torchhand.__version__, "pictures": count, **found}
