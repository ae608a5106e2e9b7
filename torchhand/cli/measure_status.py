"""Measure how well a tracker tells its hand from another one or none; write the table of likelihood ratios."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from tqdm import tqdm
from tyro.conf import arg

import torchhand
from torchhand.cli.command import DONE, OnDevice, command, parse, threads
from torchhand.devices import device_named
from torchhand.errors import InputError
from torchhand.files import read_picture
from torchhand.files.disk import write_text
from torchhand.runs import settings_of
from torchhand.runs.pictures import pictures_in, single_pose_fitter
from torchhand.study.status import (
    Finder,
    collect,
    derived_table,
    drawn_pictures,
    evidence_table,
    first_frame,
    reported_hands,
    weighed_pictures,
)
from torchhand.track import scene, single
from torchhand.track.scene import Health
from torchhand.track.single import SinglePoseSettings

_EMPTY = "pictures_without_hand"
_TABLE = Path(scene.__file__).with_name("status_rates.json")
_EVIDENCE = Path(single.__file__).with_name("evidence.json")


@dataclass(frozen=True, kw_only=True)
class Arguments(OnDevice):
    """Measure how well a tracker tells its hand from another one or none; write the table of likelihood ratios.

    Simulated pictures show a hand, or things of its colours instead; the tracker's update rule starts beside the truth,
    from wrong hands, and where a search would. FILE gets this command and, for every configuration, how often its
    thresholds are wrong, and the likelihood ratio of right hands to all others with its thresholds at false-alarm rates
    and what these miss. The same arguments give the same table.

    Example:
        torchhand measure_status --out out/status_rates.json --pictures 400
    """

    out: Annotated[Path | None, arg(metavar="FILE")] = None
    """The table; that of the package if not given."""
    configs: Annotated[tuple[str, ...], arg(metavar="NAME")] = ("contour_full", "contour_planar", "distance_full")
    """Configurations of one camera to measure."""
    pictures: int = 120
    """Simulated hands per configuration."""
    empty: int = 0
    """Pictures that show faces, portraits, arms, walls, tables, furniture, textures and other things but no hand: in
    how many a tracker's first frame and `fit_pose` report one is counted instead, and the rest of FILE kept; some
    seconds a picture."""
    photographs: Annotated[Path | None, arg(metavar="FOLDER")] = None
    """Photographs of hands, with NAME_mask.png, the skin in it, beside every NAME: FILE is then the model by which
    `fit_pose` believes a hand, fitted to these and to those of --without."""
    without: Annotated[Path | None, arg(metavar="FOLDER")] = None
    """Pictures without a hand, named KIND_ANYTHING; with --empty they take the place of drawn ones."""
    held_out: Annotated[tuple[str, ...], arg(metavar="PATTERN")] = ()
    """Names, with * for anything, of pictures on which that model is measured and to which it is not fitted."""
    every: int = 1
    """Take every so many of these pictures."""
    seed: int = 0
    """Seed of everything that is random."""


@command
def main(argv: Sequence[str] | None = None) -> int:
    """Measure every configuration; the table is written at the end."""
    arguments = parse(Arguments, argv, name="measure_status")
    if arguments.every < 1:
        raise InputError(f"--every: expected 1 or more, got {arguments.every}")
    if arguments.photographs is not None:
        if arguments.without is None:
            raise InputError("--photographs: expected --without FOLDER beside it, pictures without a hand")
        return _evidence(arguments, arguments.photographs, arguments.without)
    return _rates(arguments, arguments.out or _TABLE)


def _rates(arguments: Arguments, out: Path) -> int:
    """How often the trackers' thresholds are wrong, or how many hands are reported where there is none."""
    before: dict[str, Any] = json.loads(out.read_text(encoding="utf-8")) if out.is_file() else {}
    if arguments.empty:
        write_text(out, json.dumps(before | {_EMPTY: _empty(arguments)}, indent=1) + "\n")
        print(f"saved {out}")
        return DONE
    table: dict[str, Any] = {
        "command": f"torchhand measure_status --configs {' '.join(arguments.configs)} "
        f"--pictures {arguments.pictures} --seed {arguments.seed}",
        "version": torchhand.__version__,
    }
    device = device_named(arguments.device)
    with threads(1):
        for name in arguments.configs:
            settings = settings_of(name)
            found = collect(settings, arguments.pictures, arguments.seed, device)
            samples = list(tqdm(found, desc=name, disable=None))
            try:
                table[name] = derived_table(samples, Health(settings=settings.health))
            except ValueError as error:
                raise InputError(f"--pictures: {error}") from error
            print(f"{name}: {table[name]['health']}")
    if _EMPTY in before:
        table[_EMPTY] = before[_EMPTY]
    write_text(out, json.dumps(table, indent=1) + "\n")
    print(f"saved {out}")
    return DONE


def _empty(arguments: Arguments) -> dict[str, Any]:
    """How many hands are reported where there is none."""
    device = device_named(arguments.device)
    fitter = single_pose_fitter("right", SinglePoseSettings(), device)
    finders: dict[str, Finder] = {name: first_frame(settings_of(name), device) for name in arguments.configs}
    finders["fit_pose"] = lambda view, camera: fitter(view, camera).estimate
    photographs = [] if arguments.without is None else pictures_in(arguments.without)[: arguments.empty]
    count, found = len(photographs) or arguments.empty, {}
    with threads(1):
        for name, find in finders.items():
            given = ((_kind(path), read_picture(path)) for path in photographs)
            hands = reported_hands(find, given if photographs else drawn_pictures(count, arguments.seed))
            seen = list(tqdm(hands, desc=name, total=count, unit="picture", disable=None))
            kinds = {
                kind: sum(one.is_reported for one in seen if one.kind == kind) for kind in {o.kind: 0 for o in seen}
            }
            found[name] = {"reported": sum(kinds.values()), "by_kind": kinds}
            print(f"{name}: a hand in {found[name]['reported']} of {count} pictures without one")
    told = f"torchhand measure_status --configs {' '.join(arguments.configs)} --empty {count} --seed {arguments.seed}"
    told += "" if arguments.without is None else f" --without {arguments.without.name}"
    return {"command": told, "version": torchhand.__version__, "pictures": count, **found}


def _kind(path: Path) -> str:
    """What a picture shows: its name up to the first _."""
    return path.stem.partition("_")[0]


def _evidence(arguments: Arguments, photographs: Path, without: Path) -> int:
    """Fit the model by which a hand in a single picture is believed."""
    pictures: list[tuple[Path, Path | None]] = []
    for path in pictures_in(photographs)[:: arguments.every]:
        mask = path.with_name(f"{path.stem}_mask.png")
        if not mask.is_file():
            raise InputError(f"--photographs: expected {mask.name} beside {path.name}, the mask of its skin")
        pictures.append((path, mask))
    pictures += [(path, None) for path in pictures_in(without)[:: arguments.every]]
    fitter = single_pose_fitter("right", SinglePoseSettings(), device_named(arguments.device))
    with threads(1):
        seen = list(tqdm(weighed_pictures(fitter, pictures), total=len(pictures), unit="picture", disable=None))
    try:
        table = evidence_table(seen, arguments.held_out)
    except ValueError as error:
        raise InputError(f"--photographs, --without: {error}") from error
    patterns = "".join(f" '{pattern}'" for pattern in arguments.held_out)
    told = f"torchhand measure_status --photographs {photographs.name} --without {without.name}"
    told += f" --every {arguments.every} --held-out{patterns}"
    out = arguments.out or _EVIDENCE
    write_text(out, json.dumps({"command": told, "version": torchhand.__version__, **table}, indent=1) + "\n")
    for name in ("fitted", "held_out"):
        print(f"{name}: {table['overlap'][name]}; {table[name]}")
    print(f"saved {out}")
    return DONE
