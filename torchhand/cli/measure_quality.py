"""Measure what tells right fingers from wrong ones on simulated hands; write the models of `finger_quality`."""

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
from torchhand.files.disk import write_text
from torchhand.runs import settings_of
from torchhand.runs.pictures import single_pose_fitter
from torchhand.study.quality import calibrated, collect, collect_rigs, collect_single
from torchhand.track import quality
from torchhand.track.quality import Method
from torchhand.track.single import SinglePoseSettings

_TABLE = Path(quality.__file__).with_name("quality.json")
_CONFIGS = {"contour": "contour_full", "distance": "distance_full"}
_OF_RIGS = ("hull_lm", "contour_full", "distance_full")


@dataclass(frozen=True, kw_only=True)
class Arguments(OnDevice):
    """Measure what tells right fingers from wrong ones on simulated hands; write the models of `finger_quality`.

    Trackers find simulated hands and follow them forwards and back: half of them with a detector's points, before one
    camera a third without the network, and all before two to four cameras ("rig"); and single pictures are fitted. What
    is known of each finger then (edges, covariance, points, the network's view, how bent it is) is weighed by a
    logistic model for the probability that its tip is within 20 mm of the truth, and that for the hand. The same
    arguments give the same models; those of methods that are not measured stay in FILE.

    Example:
        torchhand measure_quality --methods contour --sequences 80
    """

    out: Annotated[Path, arg(metavar="FILE")] = _TABLE
    """The models; those of the package if not given."""
    methods: Annotated[tuple[Method, ...], arg(metavar="METHOD")] = ("contour", "distance", "rig", "single")
    """Update rules whose estimates are measured, rigs by all of them, or single pictures."""
    sequences: int = 80
    """Simulated sequences, or pictures."""
    seed: int = 0
    """Seed of everything that is random."""


@command
def main(argv: Sequence[str] | None = None) -> int:
    """Measure every method; the models of each are written when it is done."""
    arguments = parse(Arguments, argv, name="measure_quality")
    device = device_named(arguments.device)
    table: dict[str, Any] = json.loads(arguments.out.read_text(encoding="utf-8")) if arguments.out.is_file() else {}
    for method in arguments.methods:
        with threads(1):
            if method == "single":
                fitter = single_pose_fitter("right", SinglePoseSettings(), device)
                found = collect_single(fitter, arguments.sequences, arguments.seed)
            elif method == "rig":
                of_rigs = [settings_of(name) for name in _OF_RIGS]
                found = collect_rigs(of_rigs, arguments.sequences, arguments.seed, device)
            else:
                found = collect(settings_of(_CONFIGS[method]), arguments.sequences, arguments.seed, device)
            found = tqdm(found, desc=method, total=arguments.sequences, unit="sequence", disable=None)
            samples = [one for some in found for one in some]
        try:
            models = calibrated(samples)
        except ValueError as error:
            raise InputError(f"--sequences: {error}") from error
        told = f"torchhand measure_quality --methods {method} --sequences {arguments.sequences} --seed {arguments.seed}"
        table[method] = {"command": told, "version": torchhand.__version__, **models}
        for name in ("finger", "hand"):
            print(f"{method}, {name}: area under the curve {models[name]['auc']}, right {models[name]['right']:.0%}")
        write_text(arguments.out, json.dumps(table, indent=1) + "\n")
    print(f"saved {arguments.out}")
    return DONE
