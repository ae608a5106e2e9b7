"""Measure speed against peers in the same run, frames per second of the trackers, and memory."""

import importlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from itertools import count, islice
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor
from tqdm import tqdm
from tyro.conf import arg

import torchhand
from torchhand.cli.command import DONE, command, parse, threads
from torchhand.cli.request import settings_of
from torchhand.errors import InputError
from torchhand.files import load_hand_model, load_track, models_dir, save_cameras, write_video
from torchhand.files.results import UNFINISHED_NAME
from torchhand.files.safe_write import write_text
from torchhand.files.track_file import JSONL_NAME
from torchhand.geometry import Camera, assumed_camera
from torchhand.hand import JOINT_DOFS, ROOT_DOFS
from torchhand.numerics import Gaussian, UnscentedSettings, sigma_points, update
from torchhand.simulate import SceneSettings, render_sequence, scripted_motion
from torchhand.study.timing import PROC, THREAD_VARIABLES, machine_facts, time_interleaved, watch_memory
from torchhand.track.contour_tracker import ContourTracker, Memory

Name = Literal[
    "kinematics_forward",
    "kinematics_forward_backward",
    "filter_update",
    "track_planar_360x288",
    "track_full_640x480",
    "track_memory",
]
SLOW: tuple[Name, ...] = ("track_memory",)

POSES = 4096
STATE, OBSERVED, MEASUREMENTS = 81, 27, 800
FRAMES_PER_SECOND = 30.0
FOV_DEG = 48.0
MEMORY_SIZE_PX, MEMORY_FRAMES, MEMORY_RENDERED, MEMORY_SKIP = (1280, 720), 621, 40, 100
MEMORY_MUST_MIB = 1536.0

ROUNDS, TRACKING_ROUNDS = 15, 5
"""Repeats unless --repeats says otherwise."""


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """Measure speed against peers in the same run, frames per second of the trackers, and memory.

    Ours and the peer take turns, and medians of the repeats are compared. A peer that is not installed
    (pip install torchhand[benchmark]) is said so, and ours is measured alone.

    Example:
        torchhand benchmark --out benchmark.json
    """

    out: Annotated[Path | None, arg(metavar="FILE")] = None
    """Write the figures as JSON as well."""
    only: Annotated[tuple[Name, ...], arg(metavar="NAME")] = ()
    """Measure these alone: kinematics_forward, kinematics_forward_backward, filter_update, track_planar_360x288,
    track_full_640x480, track_memory."""
    everything: Annotated[bool, arg(name="all")] = False
    """Measure everything; without it track_memory, which takes a minute, is left out."""
    repeats: int | None = None
    """Repeats of every measurement; 15, for trackers 5. Memory is measured once."""
    threads: int = 1
    """Threads of torch and numpy, for ours and the peers alike."""

    def __post_init__(self) -> None:
        for name, value, most in (("repeats", self.repeats, 100_000), ("threads", self.threads, 1024)):
            if value is not None and not 1 <= value <= most:
                raise ValueError(f"--{name}: expected 1 to {most}, got {value}")

    @property
    def chosen(self) -> tuple[Name, ...]:
        """What to measure."""
        names: tuple[Name, ...] = get_args(Name)
        if self.only and not self.everything:
            return tuple(name for name in names if name in self.only)
        return names if self.everything else tuple(name for name in names if name not in SLOW)


@dataclass(frozen=True, kw_only=True)
class Figure:
    """One measurement."""

    name: str
    value: float | None
    """What `must` and `aim` are about; None where it could not be measured."""
    unit: Literal["ratio", "frames/s", "MiB"]
    """Of value, must and aim. A ratio says how many times faster than the peer ours is."""
    must: float
    """At least this; at most, where the unit is MiB."""
    aim: float | None = None
    ours_ms: float | None = None
    """Of one call, or of one frame."""
    peer: str | None = None
    peer_ms: float | None = None
    ratio: float | None = None
    repeats: int
    note: str = ""
    details: dict[str, Any] = field(default_factory=dict)

    @property
    def meets(self) -> bool | None:
        """Whether `must` holds."""
        if self.value is None:
            return None
        return self.value < self.must if self.unit == "MiB" else self.value >= self.must


@command
def main(argv: Sequence[str] | None = None) -> int:
    """Measure, print, save."""
    arguments = parse(Arguments, argv, name="benchmark")
    if arguments.out is not None and (arguments.out.is_dir() or not arguments.out.absolute().parent.is_dir()):
        raise InputError(f"{arguments.out}: --out: expected the name of a file in a folder that exists")
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
            figures.append(_MEASURES[name](name, arguments))
            print(line_of(figures[-1]), flush=True)
    if arguments.out is not None:
        entries = [asdict(figure) | {"meets": figure.meets} for figure in figures]
        found = {"torchhand": torchhand.__version__, "machine": machine, "entries": entries}
        write_text(arguments.out, json.dumps(found, indent=2) + "\n")
        print(f"saved {arguments.out}")
    return DONE


def _measured_anew(thread_count: int, argv: Sequence[str] | None) -> int:
    """The same command in a process whose libraries, numpy's among them, are loaded with so many threads."""
    call = [sys.executable, "-m", "torchhand.cli", "benchmark", *(sys.argv[1:] if argv is None else argv)]
    return subprocess.run(
        call, env=_environment() | dict.fromkeys(THREAD_VARIABLES, str(thread_count)), check=False
    ).returncode


def _environment() -> dict[str, str]:
    """Of a process that shall find this package, installed or not."""
    package = str(Path(torchhand.__file__).resolve().parents[1])
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, (package, os.environ.get("PYTHONPATH"))))}


def line_of(figure: Figure) -> str:
    """One figure as a row of the table."""
    parts = [f"{figure.name:<28}"]
    parts.append(f"{figure.ours_ms:8.2f} ms" if figure.ours_ms is not None else " " * 11)
    against = "" if figure.peer_ms is None else f"{figure.peer} {figure.peer_ms:.2f} ms"
    parts.append(f"{against:<30}")
    value = "not measured" if figure.value is None else _amount(figure.value, figure.unit)
    limits = f"must {'<' if figure.unit == 'MiB' else '>='} {_amount(figure.must, figure.unit)}"
    limits += "" if figure.aim is None else f", aim {_amount(figure.aim, figure.unit)}"
    verdict = {True: "", False: " NOT MET", None: ""}[figure.meets]
    parts.append(f"{value:<14}({limits}){verdict}")
    return "  ".join(parts) + (f"\n    {figure.note}" if figure.note else "")


def _amount(value: float, unit: str) -> str:
    return f"{value:.1f}x" if unit == "ratio" else f"{value:.0f} {unit}"


# ------------------------------------------------------------------ against peers


def _against_peer(
    name: str,
    repeats: int,
    peer: str,
    candidates: dict[str, Callable[[], object]],
    *,
    must: float,
    aim: float,
) -> Figure:
    """Time "ours", "peer" where it is there, and other variants of ours."""
    times = time_interleaved(candidates, repeats, warm_up=2)
    ours, theirs = times["ours"], times.get("peer")
    details: dict[str, Any] = {f"{side}_fastest_ms": times[side].fastest for side in times}
    for variant in times.keys() - {"ours", "peer"}:
        details[f"{variant}_ms"] = times[variant].median
        details[f"{variant}_ratio"] = None if theirs is None else times[variant].faster_than(theirs)
    ratio = None if theirs is None else ours.faster_than(theirs)
    return Figure(
        name=name,
        value=ratio,
        unit="ratio",
        must=must,
        aim=aim,
        ours_ms=ours.median,
        peer=peer,
        peer_ms=None if theirs is None else theirs.median,
        ratio=ratio,
        repeats=repeats,
        note=f"{peer} is not installed: nothing to compare with" if theirs is None else "",
        details=details,
    )


def _peer_module(name: str) -> Any:
    """A module that need not be installed; None where it is not."""
    try:
        return importlib.import_module(name)
    except ImportError:
        return None


def _poses() -> Tensor:
    return 0.3 * torch.randn(POSES, len(ROOT_DOFS) + len(JOINT_DOFS), generator=torch.Generator().manual_seed(0))


def _peer_chain(pose: Tensor) -> tuple[Any, Tensor] | None:
    """pytorch-kinematics' chain of the same URDF, and the joint angles in its order."""
    library = _peer_module("pytorch_kinematics")
    if library is None:
        return None
    chain = library.build_chain_from_urdf((models_dir() / "generic_hand" / "hand.urdf").read_bytes())
    columns = [len(ROOT_DOFS) + JOINT_DOFS.index(joint) for joint in chain.get_joint_parameter_names()]
    return chain, pose[:, columns].contiguous()


def _kinematics_forward(name: str, arguments: Arguments) -> Figure:
    """Bone transforms and keypoints of many poses, float32, against the transforms of the peer's links."""
    kinematics, pose = load_hand_model().kinematics(), _poses()
    candidates: dict[str, Callable[[], object]] = {"ours": torch.no_grad()(partial(kinematics, pose))}
    peer = _peer_chain(pose)
    if peer is not None:
        candidates["peer"] = torch.no_grad()(partial(peer[0].forward_kinematics, peer[1]))
    return _against_peer(name, arguments.repeats or ROUNDS, "pytorch-kinematics", candidates, must=4.0, aim=8.0)


def _kinematics_forward_backward(name: str, arguments: Arguments) -> Figure:
    """With gradients to the pose and to a shape per pose, against the peer's analytical ones to joint angles alone."""
    kinematics, pose = load_hand_model().kinematics(), _poses().requires_grad_()
    people = 1 + 0.02 * torch.randn(POSES, 1, generator=torch.Generator().manual_seed(1))
    shape = (people * kinematics.default_shape).requires_grad_()

    def ours() -> object:
        frames = kinematics(pose, shape)
        return torch.autograd.grad(frames.keypoints.sum() + frames.rotation.sum(), (pose, shape))

    candidates: dict[str, Callable[[], object]] = {"ours": ours}
    peer = _peer_chain(pose.detach())
    if peer is not None:
        chain, angles = peer[0], peer[1].requires_grad_()

        def theirs() -> object:
            # All links' matrices as one tensor: its quickest way.
            return torch.autograd.grad(chain.forward_kinematics_tensor(angles)[..., :3, :].sum(), angles)

        candidates["peer"] = theirs
    return _against_peer(name, arguments.repeats or ROUNDS, "pytorch-kinematics", candidates, must=3.0, aim=8.0)


def _filter_update(name: str, arguments: Arguments) -> Figure:
    """Both updates from the same sigma points and the same observations, which are computed before."""
    generator = torch.Generator().manual_seed(0)
    normal = partial(torch.randn, generator=generator, dtype=torch.float64)
    root = 0.1 * normal(STATE, STATE)
    state = Gaussian(normal(STATE), root @ root.mT + 0.01 * torch.eye(STATE, dtype=torch.float64))
    mixing = 0.2 * normal(MEASUREMENTS, OBSERVED)
    variance = 0.5 + torch.rand(MEASUREMENTS, generator=generator, dtype=torch.float64)

    def observe(states: Tensor) -> Tensor:
        return (states[..., :OBSERVED] @ mixing.mT).sin()

    points = sigma_points(state, UnscentedSettings()).points
    seen = observe(points)
    # The points of the first components alone: the centre, then plus and minus of each column.
    kept = torch.cat((torch.arange(OBSERVED + 1), 1 + STATE + torch.arange(OBSERVED)))
    seen_by_few = seen[kept]
    measurement = observe(state.mean) + 0.5 * normal(MEASUREMENTS)
    candidates: dict[str, Callable[[], object]] = {
        "ours": lambda: update(state, lambda _: seen, measurement, variance),
        f"observed_{OBSERVED}": lambda: update(state, lambda _: seen_by_few, measurement, variance, observed=OBSERVED),
    }
    library = _peer_module("filterpy.kalman")
    if library is not None:
        candidates["peer"] = _filterpy_update(library, state, points, seen, measurement, variance)
    return _against_peer(name, arguments.repeats or ROUNDS, "filterpy", candidates, must=10.0, aim=15.0)


def _filterpy_update(
    library: Any, state: Gaussian, points: Tensor, seen: Tensor, measurement: Tensor, variance: Tensor
) -> Callable[[], object]:
    calls = count()
    observations = seen.numpy()
    spread = library.MerweScaledSigmaPoints(STATE, 1.0, 2.0, 0.0)
    peer = library.UnscentedKalmanFilter(
        STATE, MEASUREMENTS, 1.0, hx=lambda _: observations[next(calls) % len(observations)], fx=None, points=spread
    )
    noise = np.diag(variance.numpy())

    def run() -> object:
        peer.x, peer.P, peer.sigmas_f = state.mean.numpy().copy(), state.covariance.numpy().copy(), points.numpy()
        peer.update(measurement.numpy(), R=noise)
        return peer.x

    return run


# ------------------------------------------------------------------ trackers


def _simulated(motion: str, size: tuple[int, int], frames: int, look: SceneSettings) -> tuple[Camera, list[Tensor]]:
    """A camera and the pictures of a hand before a plain wall."""
    kinematics = load_hand_model().kinematics(dtype=torch.float64)
    camera = replace(assumed_camera(*size, horizontal_fov_deg=FOV_DEG), is_assumed=False)
    generator = torch.Generator().manual_seed(0)
    course = scripted_motion(motion, frames, kinematics, camera, generator, fps=FRAMES_PER_SECOND)
    rendered = render_sequence(kinematics, course, camera, look, generator)
    return camera, [frame.image for frame in _with_bar(rendered, frames, "rendering")]


def _with_bar(steps: Any, total: int, what: str) -> Any:
    return tqdm(steps, total=total, desc=what, unit="frame", leave=False, disable=not sys.stderr.isatty())


def _tracking(
    name: str,
    arguments: Arguments,
    *,
    config: str,
    motion: str,
    size: tuple[int, int],
    frames: int,
    must: float,
    aim: float,
) -> Figure:
    """Frames per second of the tracker's steps alone: the pictures are there, the start is made."""
    camera, pictures = _simulated(motion, size, frames, SceneSettings())
    kinematics = load_hand_model().kinematics(dtype=torch.float64)
    tracker = ContourTracker(kinematics, camera, FRAMES_PER_SECOND, settings_of(config))
    with torch.inference_mode():
        start, memory, _ = tracker.step(None, Memory(), pictures[0])
        statuses = _track_all(tracker, start, memory, pictures[1:])
        run = partial(_track_all, tracker, start, memory, pictures[1:])
        repeats = arguments.repeats or TRACKING_ROUNDS
        [timing] = time_interleaved({"ours": run}, repeats, warm_up=0).values()
    per_frame = timing.median / len(statuses)
    tracked = statuses.count("tracked")
    return Figure(
        name=name,
        value=1e3 / per_frame,
        unit="frames/s",
        must=must,
        aim=aim,
        ours_ms=per_frame,
        repeats=repeats,
        note="" if tracked == len(statuses) else f"only {tracked} of {len(statuses)} frames were tracked",
        details={"config": config, "motion": motion, "frames": len(statuses), "tracked": tracked}
        | {"ours_fastest_ms": timing.fastest / len(statuses)},
    )


def _track_all(
    tracker: ContourTracker, state: Any, memory: Memory, pictures: Sequence[UInt8[Tensor, "height width 3"]]
) -> list[str]:
    statuses = []
    for picture in pictures:
        state, memory, estimate = tracker.step(state, memory, picture)
        statuses.append(estimate.status)
    return statuses


def _track_memory(name: str, arguments: Arguments) -> Figure:
    """Resident memory of `torchhand track` over a long video; nothing may grow with its length."""
    if not PROC.is_dir():
        note = f"resident memory is read from {PROC}, which this system does not have"
        return Figure(name=name, value=None, unit="MiB", must=MEMORY_MUST_MIB, repeats=0, note=note)
    width, height = MEMORY_SIZE_PX
    camera, pictures = _simulated("planar", MEMORY_SIZE_PX, MEMORY_RENDERED, SceneSettings(supersampling=1))
    there_and_back = pictures + pictures[-2:0:-1]
    with tempfile.TemporaryDirectory() as folder:
        video, out = Path(folder) / "hand.mp4", Path(folder) / "out"
        save_cameras([camera], Path(folder) / "cameras.json")
        with write_video(video, width=width, height=height, fps=FRAMES_PER_SECOND) as writer:
            repeated = islice((picture for _ in count() for picture in there_and_back), MEMORY_FRAMES)
            for picture in _with_bar(repeated, MEMORY_FRAMES, "writing"):
                writer.write(picture)
        del pictures, there_and_back
        options = ["--config", "contour_planar", "--no-overlay", "--threads", str(arguments.threads)]
        call = [sys.executable, "-m", "torchhand.cli", "track", str(video), "--out", str(out), *options]
        call += ["--camera", str(Path(folder) / "cameras.json")]
        with _with_bar(None, MEMORY_FRAMES, "tracking") as bar:
            used = watch_memory(
                call,
                partial(_lines_of, out),
                skip=MEMORY_SKIP,
                environment=_environment(),
                progress=lambda frames: bar.update(frames - bar.n),
            )
        tracked = int((load_track(out).status == "tracked").sum())
    growth = "unknown" if used.growth is None else f"{used.growth:+.2f} MiB per 100 frames"
    return Figure(
        name=name,
        value=used.peak,
        unit="MiB",
        must=MEMORY_MUST_MIB,
        repeats=1,
        note=f"growth from frame {MEMORY_SKIP} on: {growth}",
        details={
            "growth_mib_per_100_frames": used.growth,
            "frames": used.frames,
            "tracked": tracked,
            "picture": [width, height],
        },
    )


def _lines_of(out: Path) -> int:
    """Frames that a run has written down."""
    for folder in (out / UNFINISHED_NAME, out):
        try:
            return max(0, (folder / JSONL_NAME).read_bytes().count(b"\n") - 1)  # the first line is the header
        except OSError:
            continue
    return 0


_MEASURES: dict[Name, Callable[[str, Arguments], Figure]] = {
    "kinematics_forward": _kinematics_forward,
    "kinematics_forward_backward": _kinematics_forward_backward,
    "filter_update": _filter_update,
    "track_planar_360x288": partial(
        _tracking, config="contour_planar", motion="planar", size=(360, 288), frames=40, must=60.0, aim=150.0
    ),
    "track_full_640x480": partial(
        _tracking, config="contour_full", motion="free", size=(640, 480), frames=20, must=20.0, aim=60.0
    ),
    "track_memory": _track_memory,
}
