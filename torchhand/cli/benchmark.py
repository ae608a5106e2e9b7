"""Measure speed against peers in the same run, what the hand model promises, frames per second, and memory."""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Literal, get_args

from tyro.conf import arg

import torchhand
from torchhand.cli.benchmarks import (
    Figure,
    TrackingCase,
    crops,
    filter_update,
    fit_hand_bones,
    keypoints_to_pose,
    kinematics_compiled,
    kinematics_forward,
    kinematics_forward_backward,
    line_of,
    lm_iteration_jacfwd,
    lm_iteration_pypose,
    many_hypotheses,
    mesh_silhouettes,
    mesh_volume,
    octree,
    one_registration,
    own_environment,
    pose_projection,
    recorded_stream,
    skinning,
    soak_of_filters,
    soak_of_tracking,
    soft_silhouettes,
    synthetic_stream,
    track_memory,
    track_views,
    track_views_memory,
    tracking,
)
from torchhand.cli.command import DONE, OnDevice, command, parse, threads
from torchhand.devices import device_named
from torchhand.errors import InputError
from torchhand.evaluate import THREAD_VARIABLES, machine_facts
from torchhand.files.disk import write_text

Name = Literal[
    "kinematics_forward",
    "kinematics_forward_backward",
    "kinematics_compiled",
    "skinning_forward_4096",
    "skinning_gradients_64",
    "skinning_gradients_1024",
    "mesh_silhouettes",
    "soft_silhouettes",
    "crops",
    "mesh_volume",
    "pose_projection",
    "keypoints_to_pose",
    "filter_update",
    "registration",
    "registration_many",
    "lm_iteration_jacfwd",
    "lm_iteration_pypose",
    "octree_level7",
    "octree_level8",
    "track_planar_360x288",
    "track_full_640x480",
    "track_full_points_640x480",
    "track_full_twice_640x480",
    "track_full_twice_points_640x480",
    "track_full_without_network_640x480",
    "track_distance_640x480",
    "track_distance_points_640x480",
    "track_views_640x480",
    "track_memory",
    "track_views_memory",
    "fit_hand_bones",
    "pose_stream",
    "pose_stream_recorded",
    "soak_filters",
    "soak_tracking",
]
SOAK: tuple[Name, ...] = ("soak_filters", "soak_tracking")
TRACKED: dict[Name, TrackingCase] = {
    "track_full_640x480": TrackingCase(config="contour_full"),
    "track_full_points_640x480": TrackingCase(config="contour_full", has_points=True),
    "track_full_twice_640x480": TrackingCase(config="contour_full", passes=2),
    "track_full_twice_points_640x480": TrackingCase(config="contour_full", has_points=True, passes=2),
    "track_full_without_network_640x480": TrackingCase(config="contour_full", has_network=False),
    "track_distance_640x480": TrackingCase(config="distance_full"),
    "track_distance_points_640x480": TrackingCase(config="distance_full", has_points=True),
}
"""Trackers of 27 degrees of freedom; "twice" is with the second pass, whose time counts for the same frames."""
ON_DEVICES: tuple[Name, ...] = (
    *("kinematics_forward", "kinematics_forward_backward"),
    *("skinning_forward_4096", "skinning_gradients_64", "skinning_gradients_1024"),
    *("registration", "registration_many", "track_planar_360x288"),
    *TRACKED,
)
"""What --device moves; the rest is measured on the processor."""
SLOW: tuple[Name, ...] = ("track_memory", "track_views_memory", "fit_hand_bones", *SOAK)


@dataclass(frozen=True, kw_only=True)
class Arguments(OnDevice):
    """Measure speed against peers in the same run, what the hand model promises, frames per second, and memory.

    Ours and the peer take turns, and medians of the repeats are compared. A peer that is not installed
    (pip install torchhand[benchmark]; smplx, whose licence is not permissive, by name) is said so, and ours is measured
    alone.

    Example:
        torchhand benchmark --out benchmark.json
    """

    out: Annotated[Path | None, arg(metavar="FILE")] = None
    """Write the figures as JSON as well."""
    only: Annotated[tuple[Name | Literal["soak"], ...], arg(metavar="NAME")] = ()
    """Measure these alone: kinematics_forward, kinematics_forward_backward, kinematics_compiled, skinning_forward_4096,
    skinning_gradients_64, skinning_gradients_1024, mesh_silhouettes, soft_silhouettes, crops, mesh_volume,
    pose_projection, keypoints_to_pose,
    filter_update, registration, registration_many, lm_iteration_jacfwd, lm_iteration_pypose, octree_level7,
    octree_level8, track_planar_360x288, track_full_640x480, track_full_points_640x480, track_full_twice_640x480,
    track_full_twice_points_640x480, track_full_without_network_640x480, track_distance_640x480,
    track_distance_points_640x480, track_views_640x480, track_memory, track_views_memory, fit_hand_bones, pose_stream,
    pose_stream_recorded, soak_filters, soak_tracking; soak is the last two."""
    recording: Annotated[tuple[Path, ...], arg(metavar="FILE")] = ()
    """Recordings of a sensing glove (rows of 7 time columns and 23 angles), which pose_stream_recorded needs."""
    everything: Annotated[bool, arg(name="all")] = False
    """Measure everything; without it track_memory, track_views_memory, fit_hand_bones and soak, which take minutes or
    more, are left out."""
    repeats: int | None = None
    """Repeats of every measurement; 15, for skinning and iterations 9, for trackers 5, for many hypotheses 3; people
    of fit_hand_bones, 50. Memory is measured once."""
    soak_steps: int = 1_000_000
    """Steps of filters on hostile input that soak_filters takes, over all kinds of filters."""
    soak_minutes: float = 60.0
    """Minutes for which soak_tracking follows a hand."""
    threads: int = 1
    """Threads of torch and numpy, for ours and the peers alike."""

    def __post_init__(self) -> None:
        for name, value, maximum in (("repeats", self.repeats, 100_000), ("threads", self.threads, 1024)):
            if value is not None and not 1 <= value <= maximum:
                raise ValueError(f"--{name}: expected 1 to {maximum}, got {value}")
        elsewhere = [name for name in self.only if name not in ON_DEVICES] if self.device != "cpu" else []
        if elsewhere:
            raise ValueError(f"--device: expected cpu for {elsewhere[0]}, which is measured on the processor")
        if not 1 <= self.soak_steps <= 1_000_000_000:
            raise ValueError(f"--soak-steps: expected 1 to 1000000000, got {self.soak_steps}")
        if not 0 < self.soak_minutes <= 10_000:
            raise ValueError(f"--soak-minutes: expected above 0 and at most 10000, got {self.soak_minutes}")

    @property
    def chosen(self) -> tuple[Name, ...]:
        """What to measure."""
        names: tuple[Name, ...] = get_args(Name)
        if self.device != "cpu":
            names = ON_DEVICES
        if self.only and not self.everything:
            wanted = {*self.only, *(SOAK if "soak" in self.only else ())}
            return tuple(name for name in names if name in wanted)
        return names if self.everything else tuple(name for name in names if name not in SLOW)


@command
def main(argv: Sequence[str] | None = None) -> int:
    """Measure, print, save."""
    arguments = parse(Arguments, argv, name="benchmark")
    if arguments.out is not None and (arguments.out.is_dir() or not arguments.out.absolute().parent.is_dir()):
        raise InputError(f"{arguments.out}: --out: expected the name of a file in a folder that exists")
    device_named(arguments.device)  # a mistake is told before the work
    if any(os.environ.get(name) != str(arguments.threads) for name in THREAD_VARIABLES):
        return _measured_anew(arguments.threads, argv)
    with threads(arguments.threads):
        machine = machine_facts()
        print(
            f"torch {machine['torch']}, {machine['torch_threads']} of {machine['cpu_count']} threads, python"
            f" {machine['python']}, {machine['processor']}"
        )
        figures = []
        for name in arguments.chosen:
            figures.append(_measure(name, arguments))
            print(line_of(figures[-1]), flush=True)
    if arguments.out is not None:
        entries = [asdict(figure) | {"meets": figure.meets} for figure in figures]
        found = {"torchhand": torchhand.__version__, "machine": machine, "entries": entries}
        write_text(arguments.out, json.dumps(found, indent=2) + "\n")
        print(f"saved {arguments.out}")
    return DONE


def _measure(name: Name, arguments: Arguments) -> Figure:
    measure: Callable[..., Figure] = _MEASURES[name]
    if measure is recorded_stream:
        measure = partial(recorded_stream, recordings=arguments.recording)
    elif measure is soak_of_filters:
        measure = partial(soak_of_filters, steps=arguments.soak_steps)
    elif measure is soak_of_tracking:
        measure = partial(soak_of_tracking, minutes=arguments.soak_minutes)
    elif name in ON_DEVICES:
        measure = partial(measure, device=device_named(arguments.device))
    return measure(name, arguments.repeats)


def _measured_anew(thread_count: int, argv: Sequence[str] | None) -> int:
    """The same command in a process whose libraries, numpy's among them, are loaded with so many threads."""
    call = [sys.executable, "-m", "torchhand.cli", "benchmark", *(sys.argv[1:] if argv is None else argv)]
    return subprocess.run(
        call, env=own_environment() | dict.fromkeys(THREAD_VARIABLES, str(thread_count)), check=False
    ).returncode


_MEASURES: dict[Name, Callable[[str, int | None], Figure]] = {
    "kinematics_forward": kinematics_forward,
    "kinematics_forward_backward": kinematics_forward_backward,
    "kinematics_compiled": kinematics_compiled,
    "skinning_forward_4096": partial(skinning, count=4096, has_gradients=False, must=1 / 0.7, aim=1 / 0.3),
    "skinning_gradients_64": partial(skinning, count=64, has_gradients=True, must=1 / 0.7, aim=1 / 0.4),
    "skinning_gradients_1024": partial(skinning, count=1024, has_gradients=True, must=1 / 0.7, aim=1 / 0.4),
    "mesh_silhouettes": mesh_silhouettes,
    "soft_silhouettes": soft_silhouettes,
    "crops": crops,
    "mesh_volume": mesh_volume,
    "pose_projection": pose_projection,
    "keypoints_to_pose": keypoints_to_pose,
    "filter_update": filter_update,
    "registration": one_registration,
    "registration_many": many_hypotheses,
    "lm_iteration_jacfwd": lm_iteration_jacfwd,
    "lm_iteration_pypose": lm_iteration_pypose,
    "octree_level7": partial(octree, level=7, must=25.0, aim=12.0),
    "octree_level8": partial(octree, level=8, must=45.0, aim=25.0),
    "track_planar_360x288": partial(
        tracking,
        case=TrackingCase(config="contour_planar", motion="planar", size=(360, 288), frames=40),
        must=60.0,
        aim=150.0,
    ),
    **{
        name: partial(tracking, case=case, must=25.0 / case.passes, aim=60.0 / case.passes)
        for name, case in TRACKED.items()
    },
    "track_views_640x480": partial(track_views, must=30.0, aim=45.0),
    "track_memory": track_memory,
    "track_views_memory": track_views_memory,
    "fit_hand_bones": fit_hand_bones,
    "pose_stream": synthetic_stream,
    "pose_stream_recorded": recorded_stream,
    "soak_filters": soak_of_filters,
    "soak_tracking": soak_of_tracking,
}
