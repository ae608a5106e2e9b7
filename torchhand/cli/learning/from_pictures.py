"""`torchhand learn_pose --pictures`: from crops of the simulator, and from recordings that nobody has labelled."""

import json
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

import cv2
import torch
from tqdm import tqdm

import torchhand
from torchhand.cli.command import DONE, STOPPED_BY_USER, threads
from torchhand.cli.learning.folders import check_same, check_training_folder
from torchhand.devices import sent_to
from torchhand.draw import Axes, draw_chart
from torchhand.errors import InputError
from torchhand.files import load_hand_model
from torchhand.files.disk import replacing, write_text
from torchhand.hand import HandModel, Side
from torchhand.learn import CURVE_NAME, FIGURES, MODEL_NAME, Curve, Figures
from torchhand.learn.pictures import (
    LOG_NAME,
    RECORDED_FIGURES,
    PictureData,
    PictureProgress,
    PictureTraining,
    RecordedCrops,
    SimulatedCrops,
    TrueCrops,
    load_picture_record,
    new_picture_training,
    picture_data,
    recorded_crops,
    recorded_figures,
    save_picture_record,
    simulated_data,
    step_generator,
    still_crops,
    train_from_pictures,
    true_figures,
)

PICTURE_NAME, FIGURES_NAME = "curve.png", "figures.json"
_MEASUREMENTS, _MIN_STEPS = 30, 25
_SHOWN = ("held_out/aligned_mm", "judge/overlap", "judge/points_px", "stills/aligned_mm")
_WHERE = {
    "held_out": "simulated crops it has never seen",
    "judge": "frames to measure on",
    "stills": "pictures with true joints",
}


@dataclass(frozen=True, kw_only=True)
class Sources:
    """Real pictures to learn from and to measure on."""

    video: str | None
    keypoints: str | None
    frames: tuple[int, int]
    judge: tuple[int, int] | None
    evaluate: str | None
    side: Side

    def __post_init__(self) -> None:
        if (self.video is None) != (self.keypoints is None):
            raise InputError("--video and --keypoints: expected both or none, got one")
        if self.judge is not None and self.video is None:
            raise InputError("--judge: expected with --video alone; got it without one")
        for name in ("frames", "judge"):
            ends = getattr(self, name)
            if ends is not None and not 0 <= ends[0] <= ends[1]:
                raise InputError(f"--{name}: expected the first and the last frame, got {ends[0]} {ends[1]}")

    @classmethod
    def of_record(cls, kept: Mapping[str, object]) -> "Sources":
        """As a training was begun with them."""
        pairs = {name: tuple(value) if isinstance(value, list) else value for name, value in kept.items()}
        return cls(**pairs)  # type: ignore[arg-type]


@dataclass(frozen=True, kw_only=True)
class PictureJob:
    """What the command was asked for."""

    out: Path
    given: dict[str, int]
    """Settings other than usual, by their names in PictureTraining."""
    sources: Sources
    resume: bool
    overwrite: bool
    threads: int
    device: torch.device


@dataclass(frozen=True, kw_only=True)
class _Measured:
    """What is measured on at every report."""

    held_out: SimulatedCrops
    judged: RecordedCrops | None
    stills: TrueCrops | None

    def figures(self, training: PictureProgress, data: PictureData) -> Figures:
        """All figures, named PLACE/FIGURE."""
        found = {"held_out": true_figures(training.network, self.held_out)}
        if self.judged is not None:
            found["judge"] = recorded_figures(training.network, self.judged, data.teacher)
        if self.stills is not None:
            found["stills"] = true_figures(training.network, self.stills)
        return {f"{place}/{name}": value for place, row in found.items() for name, value in row.items()}


def learn_from_pictures(job: PictureJob) -> int:
    """Train, or go on training, and measure."""
    check_training_folder(job.out, resume=job.resume, overwrite=job.overwrite)
    record = load_picture_record(job.out) if job.resume else None
    if record is None:
        try:
            settings = replace(PictureTraining(), **job.given)
        except ValueError as error:
            raise InputError(f"--{error}") from error
        settings = settings if job.sources.video else replace(settings, recorded_steps=0)
        sources, curve = job.sources, []
    else:
        settings, sources, curve = record.settings, Sources.of_record(record.sources), record.curve
        check_same(job.given, settings, job.out)
        usual = Sources(video=None, keypoints=None, frames=(0, 1_000_000), judge=None, evaluate=None, side="right")
        names = (one.name for one in fields(Sources))
        changed = {name: value for name in names if (value := getattr(job.sources, name)) != getattr(usual, name)}
        check_same(changed, sources, job.out)
    with threads(job.threads):
        model = load_hand_model()
        data, measured = _data(settings, sources, model, job.device)
        training = new_picture_training(settings, model, data.simulated.joints.mean(0), job.device)
        training = training if record is None else record.restored(training)
        try:
            _train(training, data, measured, curve, job.out, sources)
        except KeyboardInterrupt:
            print(f"torchhand learn_pose: stopped by Ctrl-C; --resume goes on from {job.out}", file=sys.stderr)
            return STOPPED_BY_USER
    _report(settings, sources, curve, job.out)
    return DONE


def _data(
    settings: PictureTraining, sources: Sources, model: HandModel, device: torch.device
) -> tuple[PictureData, _Measured]:
    """Everything is made anew from the seed; mistakes in files are told before the long work."""
    stills = None if sources.evaluate is None else still_crops(Path(sources.evaluate), sources.side)
    recorded = judged = None
    if sources.video is not None and sources.keypoints is not None:
        files = Path(sources.video), Path(sources.keypoints)
        generator = step_generator(settings.seed, -3)
        with _bar("reading", None, "frame") as bar:
            learned = range(sources.frames[0], sources.frames[1] + 1)
            recorded = recorded_crops(*files, learned, views=settings.views, generator=generator, tick=bar.update)
            if sources.judge is not None:
                judged = recorded_crops(*files, range(sources.judge[0], sources.judge[1] + 1), tick=bar.update)
    with _bar("simulating", settings.pool + settings.held_out, "crop") as bar:
        simulated, held_out = simulated_data(settings, model, bar.update)
    data = picture_data(settings, model, simulated, recorded, device)
    return data, _Measured(held_out=held_out, judged=None if judged is None else sent_to(judged, device), stills=stills)


def _train(
    training: PictureProgress, data: PictureData, measured: _Measured, curve: Curve, out: Path, sources: Sources
) -> None:
    """Train to the end; the curve grows and everything is saved at every measurement."""
    settings = training.settings
    steps = settings.steps + settings.recorded_steps
    with _bar("learning", steps, "step") as bar:
        bar.update(training.step)
        for reached in train_from_pictures(training, data, pause_every=max(_MIN_STEPS, steps // _MEASUREMENTS)):
            curve.append({"step": reached.step, "loss": reached.loss, **measured.figures(reached, data)})
            save_picture_record(out, reached, asdict(sources), curve)
            _draw(out, curve)
            bar.update(reached.step - bar.n)


def _bar(what: str, total: int | None, unit: str) -> tqdm:
    return tqdm(total=total, desc=what, unit=unit, disable=not sys.stderr.isatty(), leave=False)


def _draw(out: Path, curve: Curve) -> None:
    steps = [row["step"] for row in curve]
    shown = [name for name in _SHOWN if name in curve[0]]
    charts = [draw_chart(Axes(name, x_name="step"), steps, {"network": [row[name] for row in curve]}) for name in shown]
    with replacing(out / PICTURE_NAME) as temporary:
        cv2.imwrite(str(temporary), cv2.cvtColor(torch.cat(charts, 1).numpy(), cv2.COLOR_RGB2BGR))


def _report(settings: PictureTraining, sources: Sources, curve: Curve, out: Path) -> None:
    """The figures at the end of the steps on the simulator alone and at the end of all, in a file and as a table."""
    alone = next(row for row in curve if row["step"] == settings.steps)
    rows = {"simulator": alone} | ({"recording": curve[-1]} if settings.recorded_steps else {})
    header = {"torchhand": torchhand.__version__, "settings": asdict(settings), "sources": asdict(sources)}
    write_text(out / FIGURES_NAME, json.dumps({**header, **rows}, indent=2) + "\n")
    texts = FIGURES | RECORDED_FIGURES
    print(f"{'learned from':<92}" + "".join(f"{name:>13}" for name in rows))
    for key in alone:
        place, _, name = key.partition("/")
        if name:
            digits = 3 if name == "overlap" else 1
            values = "".join(f"{row[key]:>13.{digits}f}" for row in rows.values())
            print(f"{f'{_WHERE[place]}: {texts[name]}':<92}{values}")
    print(f"saved {MODEL_NAME}, {CURVE_NAME}, {LOG_NAME}, {PICTURE_NAME} and {FIGURES_NAME} in {out}")
