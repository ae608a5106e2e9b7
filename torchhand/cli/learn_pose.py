"""Train a small network from 21 noisy 2D keypoints to a hand's pose, with the hand module as its decoder."""

import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import cv2
import torch
from tqdm import tqdm
from tyro.conf import arg

import torchhand
from torchhand.cli.command import DONE, STOPPED_BY_USER, OnDevice, command, parse, threads
from torchhand.cli.learning import PictureJob, Sources, check_same, check_training_folder, learn_from_pictures
from torchhand.devices import device_named
from torchhand.draw import Axes, draw_chart
from torchhand.errors import InputError
from torchhand.files import load_hand_model
from torchhand.files.disk import replacing, write_text
from torchhand.hand import Side
from torchhand.learn import (
    CURVE_NAME,
    FIGURES,
    MODEL_NAME,
    Curve,
    Figures,
    PoseNetwork,
    Stills,
    Training,
    TrainingData,
    TrainingSettings,
    baseline_of,
    estimate_hands,
    figures_of,
    load_record,
    load_stills,
    new_training,
    restored,
    save_record,
    train,
    training_data,
)

PICTURE_NAME, FIGURES_NAME = "curve.png", "figures.json"
MEASUREMENTS = 40  # along the curve
MIN_STEPS = 25  # between two of them
_COUNTS = ("steps", "seed", "batch", "pool")
SHOWN = ("flexion_deg", "root_relative_mm", "aligned_mm")
"""Figures that curve.png shows."""


@dataclass(frozen=True, kw_only=True)
class Arguments(OnDevice):
    """Train a small network from 21 noisy 2D keypoints to a hand's pose, with the hand module as its decoder.

    It learns from random hands of the prior before random cameras, in minutes on a CPU. DIR gets model.pt, curve.csv,
    curve.png and figures.json: errors on hands it has never seen, and those of one mean posture for all of them, turned
    as fits best. The same arguments give the same network on the same machine.

    With --pictures a network sees crops of pictures: those of the simulator first, then also those of VIDEO, where the
    silhouette (by the colours of skin) and the detected points are its only teachers. log.jsonl and, where the package
    tensorboard is installed, events/ hold the curve as well.

    Examples:
        torchhand learn_pose --out out/learn --evaluate data/real/joints3d_stills --side left
        torchhand learn_pose --pictures --out out/seen --video hand.mp4 --keypoints hand.npz --frames 0 400
    """

    out: Annotated[Path, arg(metavar="DIR")]
    """Folder for the results."""
    steps: int | None = None
    """Steps of training; 4000 if not given; with --pictures those on the simulator alone."""
    seed: int | None = None
    """Seed of everything that is random; 0 if not given."""
    batch: int | None = None
    """Hands per step; 256 if not given, with --pictures 64."""
    pool: int | None = None
    """Hands of the prior, or crops of the simulator, to train on; 20000 if not given."""
    resume: bool = False
    """Go on with an interrupted training; a finished one is only evaluated."""
    overwrite: bool = False
    """Replace an older training in DIR."""
    evaluate: Annotated[Path | None, arg(metavar="FOLDER")] = None
    """Measure the network on pictures with truth.npz: image names, K (N, 3, 3) and keypoints3d (N, 21, 3) in metres in
    the camera frame. It sees their projections; with --pictures the pictures in images/, cut around these."""
    side: Literal["left", "right"] = "right"
    """Which hand FOLDER shows; the network is of a right hand and sees left ones in the mirror."""
    pictures: bool = False
    """Learn from crops of pictures in place of points."""
    video: Annotated[Path | None, arg(metavar="VIDEO")] = None
    """With --pictures: recording to learn from as well, unlabelled."""
    keypoints: Annotated[Path | None, arg(metavar="FILE")] = None
    """What a detector found in VIDEO; see fit_keypoints."""
    frames: tuple[int, int] = (0, 1_000_000)
    """First and last frame of VIDEO to learn from."""
    judge: tuple[int, int] | None = None
    """First and last frame of VIDEO to measure on."""
    threads: int = 1
    """Threads of the training; small tensors gain little by more than one."""


@command
def main(argv: Sequence[str] | None = None) -> int:
    """Train, or go on training, and measure."""
    arguments = parse(Arguments, argv, name="learn_pose")
    device = device_named(arguments.device)
    if arguments.pictures:
        return learn_from_pictures(_picture_job(arguments))
    if arguments.video is not None or arguments.keypoints is not None or arguments.judge is not None:
        raise InputError("--video, --keypoints, --judge: expected with --pictures alone; got them without it")
    stills = (
        None if arguments.evaluate is None else load_stills(arguments.evaluate)
    )  # a mistake is told before training
    settings, curve, kept = _begin(arguments)
    with threads(arguments.threads):
        model = load_hand_model()
        data = training_data(settings, model, device)
        training = new_training(settings, model, data, device)
        training = training if kept is None else restored(training, kept)
        baseline = baseline_of(training.network, data.held_out.keypoints)
        try:
            _train(training, data, curve, baseline, arguments.out)
        except KeyboardInterrupt:
            print(f"torchhand learn_pose: stopped by Ctrl-C; --resume goes on from {arguments.out}", file=sys.stderr)
            return STOPPED_BY_USER
        figures = {"held_out": {"network": _held_out(training, data), "baseline": baseline}}
        if stills is not None:
            figures["stills"] = _on_stills(training.network, stills, arguments.side)
    header = {"torchhand": torchhand.__version__, "steps": training.step, "settings": asdict(settings)}
    write_text(arguments.out / FIGURES_NAME, json.dumps({**header, **figures}, indent=2) + "\n")
    for where, table in figures.items():
        print(_table(where, table))
    print(f"saved {MODEL_NAME}, {CURVE_NAME}, {PICTURE_NAME} and {FIGURES_NAME} in {arguments.out}")
    return DONE


def _picture_job(arguments: Arguments) -> PictureJob:
    """What of the arguments says how to learn from pictures."""
    given = {name: value for name in _COUNTS if (value := getattr(arguments, name)) is not None}
    paths = {name: getattr(arguments, name) for name in ("video", "keypoints", "evaluate")}
    return PictureJob(
        out=arguments.out,
        given=given,
        sources=Sources(
            **{name: None if path is None else str(path) for name, path in paths.items()},
            frames=arguments.frames,
            judge=arguments.judge,
            side=arguments.side,
        ),
        resume=arguments.resume,
        overwrite=arguments.overwrite,
        threads=arguments.threads,
        device=device_named(arguments.device),
    )


def _begin(arguments: Arguments) -> tuple[TrainingSettings, Curve, dict[str, Any] | None]:
    """Settings, and of a training to go on with its curve and state."""
    given = {name: value for name in _COUNTS if (value := getattr(arguments, name)) is not None}
    if arguments.resume:
        check_training_folder(arguments.out, resume=True, overwrite=arguments.overwrite)
        record = load_record(arguments.out)
        check_same(given, record.settings, arguments.out)
        return record.settings, record.curve, record.kept
    try:
        settings = replace(TrainingSettings(), **given)
    except ValueError as error:
        raise InputError(f"--{error}") from error
    check_training_folder(arguments.out, resume=False, overwrite=arguments.overwrite)
    return settings, [], None


def _train(training: Training, data: TrainingData, curve: Curve, baseline: Figures, out: Path) -> None:
    """Train to the end; the curve grows and everything is saved at every measurement."""
    steps = training.settings.steps
    bar = tqdm(
        total=steps, initial=training.step, desc="learning", unit="step", disable=not sys.stderr.isatty(), leave=False
    )
    with bar:
        for reached in train(training, data, pause_every=max(MIN_STEPS, steps // MEASUREMENTS)):
            curve.append({"step": reached.step, "loss": reached.loss, **_held_out(reached, data)})
            save_record(out, reached, curve)
            _draw(out, curve, baseline)
            bar.update(reached.step - bar.n)
            bar.set_postfix(flexion_deg=f"{curve[-1]['flexion_deg']:.1f}")


def _held_out(training: Training, data: TrainingData) -> Figures:
    estimate = estimate_hands(training.network, data.held_out.points_plane, data.held_out.seen)
    return figures_of(estimate.keypoints, data.held_out.keypoints)


def _on_stills(network: PoseNetwork, stills: Stills, side: Side) -> dict[str, Figures]:
    estimate = estimate_hands(network, stills.points_plane, side=side)
    return {
        "network": figures_of(estimate.keypoints, stills.keypoints),
        "baseline": baseline_of(network, stills.keypoints, is_left=side == "left"),
    }


def _draw(out: Path, curve: Curve, baseline: Figures) -> None:
    steps = [row["step"] for row in curve]
    charts = [
        draw_chart(
            Axes(FIGURES[name], x_name="step"),
            steps,
            {"network": [row[name] for row in curve]},
            levels={"mean posture": baseline[name]},
        )
        for name in SHOWN
    ]
    with replacing(out / PICTURE_NAME) as temporary:
        cv2.imwrite(str(temporary), cv2.cvtColor(torch.cat(charts, 1).numpy(), cv2.COLOR_RGB2BGR))


def _table(where: str, figures: dict[str, Figures]) -> str:
    """One line for each figure: the network's and the baseline's."""
    head = f"{where.replace('_', ' '):<62}{'network':>10}{'mean posture':>15}"
    rows = []
    for name, text in FIGURES.items():
        own, constant = figures["network"][name], figures["baseline"][name]
        rows.append(f"  {text:<60}{own:>10.1f}{constant:>15.1f}")
    return "\n".join((head, *rows))
