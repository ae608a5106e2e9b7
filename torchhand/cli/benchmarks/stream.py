"""Measures of `torchhand benchmark` on pose streams: kbit/s against error of the joint angles, 25 frames a second."""

from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float64
from torch import Tensor

from torchhand.cli.benchmarks.figures import Figure
from torchhand.evaluate import time_interleaved
from torchhand.export import MotionClip, StreamSettings, encode_clip
from torchhand.export.stream import StreamFigures
from torchhand.files import load_hand_model
from torchhand.geometry import assumed_camera
from torchhand.hand import DOFS, ROOT_DOFS, HandModel
from torchhand.simulate import Staging, joints_of_glove, read_glove, scripted_motion

FPS = 25.0
SECONDS = 60  # of the synthetic motion
STEPS_DEG = (1.0, 2.0, 3.0, 3.5, 4.0, 5.0, 6.0)
ALLOWED_DEG = 1.0
MUST, AIM = 2.0, 1.0
"""kbit/s at a mean error of the joint angles of ALLOWED_DEG at most."""
ROUNDS = 3
SYNTHETIC = "free"


def synthetic_stream(name: str, repeats: int | None) -> Figure:
    """A scripted motion of every joint and of the whole hand: needs nothing but the repository."""
    model = load_hand_model()
    camera = assumed_camera(640, 480)
    generator = torch.Generator().manual_seed(0)
    kinematics = model.kinematics(dtype=torch.float64)
    motion = scripted_motion(SYNTHETIC, int(FPS * SECONDS), kinematics, camera, generator, staging=Staging(fps=FPS))
    return _figure(name, repeats, {SYNTHETIC: _clip(model, motion.poses.double())})


def recorded_stream(name: str, repeats: int | None, *, recordings: tuple[Path, ...] = ()) -> Figure:
    """Joint angles of a sensing glove, brought to 25 frames a second; the worst of the recordings."""
    if not recordings:
        note = "needs a sensing glove's recording of joint angles: --recording FILE"
        return Figure(name=name, value=None, unit="kbit/s", must=MUST, aim=AIM, repeats=0, note=note)
    model = load_hand_model()
    return _figure(name, repeats, {path.stem: _clip(model, recorded_poses(model, path)) for path in recordings})


def recorded_poses(model: HandModel, path: Path) -> Float64[Tensor, "frames 36"]:
    """A glove's recording at 25 frames a second, within the skeleton's limits, the hand at rest at the origin."""
    recording = read_glove(path)
    seconds = np.arange(0.0, float(recording.seconds[-1]) + 1e-9, 1 / FPS)
    joints = model.skeleton.within_limits(joints_of_glove(recording, seconds))
    return torch.cat((joints.new_zeros(len(joints), len(ROOT_DOFS)), joints), -1)


def _clip(model: HandModel, poses: Float64[Tensor, "frames 36"]) -> MotionClip:
    return MotionClip(model=model, side="right", shape=model.shape_space.default.double(), poses=poses, fps=FPS)


def _figure(name: str, repeats: int | None, clips: dict[str, MotionClip]) -> Figure:
    """The table of all clips; the value is that of the clip which takes most."""
    rows = {(clip, step): _measured(clips[clip], step) for clip in clips for step in STEPS_DEG}
    best = {}
    for clip in clips:
        fitting = [rows[clip, step].kbit_per_s for step in STEPS_DEG if rows[clip, step].mean_deg <= ALLOWED_DEG]
        best[clip] = min(fitting, default=float("inf"))
    worst = max(best, key=lambda clip: best[clip])
    rounds = repeats or ROUNDS
    times = time_interleaved({"ours": lambda: _measured(clips[worst], 3.5)}, rounds)["ours"]
    lines = [f"{clip}: {_row(step, figures)}" for (clip, step), figures in rows.items()]
    moving = {clip: [dof for i, dof in enumerate(DOFS) if _moves(clips[clip], i)] for clip in clips}
    return Figure(
        name=name,
        value=best[worst],
        unit="kbit/s",
        must=MUST,
        aim=AIM,
        ours_ms=times.median / len(clips[worst]),
        repeats=rounds,
        note="\n    ".join(lines),
        details={
            "kbit_per_s": best,
            "still_fraction": {clip: _still_fraction(clips[clip]) for clip in clips},
            "dofs": moving,
            "table": [{"clip": clip, "step_deg": step} | _entry(figures) for (clip, step), figures in rows.items()],
        },
    )


def _measured(clip: MotionClip, step_deg: float) -> StreamFigures:
    return encode_clip(clip, StreamSettings(step_deg=step_deg))[1]


def _row(step_deg: float, figures: StreamFigures) -> str:
    return (
        f"step {step_deg:3.1f}°  {figures.kbit_per_s:6.3f} kbit/s ({figures.motion_kbit_per_s:6.3f} without the header)"
        f"  mean error {figures.mean_deg:.2f}°, worst {figures.worst_deg:.1f}°"
    )


def _entry(figures: StreamFigures) -> dict[str, float | int]:
    return asdict(figures) | {"kbit_per_s": figures.kbit_per_s, "motion_kbit_per_s": figures.motion_kbit_per_s}


def _moves(clip: MotionClip, column: int) -> bool:
    return bool((clip.poses[:, column] != clip.poses[0, column]).any())


def _still_fraction(clip: MotionClip) -> float:
    """Share of the frames in which no joint angle changes by more than a tenth of a degree."""
    change = torch.rad2deg(clip.poses[:, len(ROOT_DOFS) :].diff(dim=0)).abs().amax(-1)
    return float((change <= 0.1).double().mean())
