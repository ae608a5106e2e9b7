"""What a training from pictures leaves in its folder: the network with all that is needed to go on, and its log."""

import importlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch

from torchhand.files.disk import write_text
from torchhand.hand import HandModel
from torchhand.learn import (
    CURVE_NAME,
    Curve,
    LossWeights,
    curve_of,
    curve_text,
    kept_of,
    kept_state,
    read_model,
    write_model,
)
from torchhand.learn.pictures.network import PictureNetwork
from torchhand.learn.pictures.teaching import TeachingWeights
from torchhand.learn.pictures.training import PictureProgress, PictureTraining, new_picture_training

LOG_NAME, EVENTS_NAME = "log.jsonl", "events"
_FORMAT = "torchhand learn_pose --pictures 1"


@dataclass(frozen=True, kw_only=True)
class PictureRecord:
    """A saved training from pictures."""

    settings: PictureTraining
    sources: dict[str, Any]
    """The recording that it learns from, as the command names it."""
    curve: Curve
    kept: dict[str, Any]
    """State of network and optimiser, and the step."""

    def network(self, model: HandModel) -> PictureNetwork:
        """The network as it was saved, to be used."""
        network = new_picture_training(self.settings, model, torch.zeros(30)).network
        network.load_state_dict(self.kept["network"])
        return network.eval()

    def restored(self, training: PictureProgress) -> PictureProgress:
        """The training (as `new_picture_training` made it) at the point where this was saved."""
        training.network.load_state_dict(self.kept["network"])
        training.optimiser.load_state_dict(self.kept["optimiser"])
        training.step = int(self.kept["step"])
        training.network.eval()
        return training


def save_picture_record(folder: Path, training: PictureProgress, sources: dict[str, Any], curve: Curve) -> None:
    """Write model.pt, curve.csv and log.jsonl, each whole or not at all; and, where the package tensorboard is
    installed, the last row to its event files."""
    content = {
        "format": _FORMAT,
        "settings": asdict(training.settings),
        "sources": sources,
        "curve": curve,
        **kept_state(training.step, training.network, training.optimiser),
    }
    write_model(folder, content)
    write_text(folder / CURVE_NAME, curve_text(curve))
    write_text(folder / LOG_NAME, "".join(json.dumps(row) + "\n" for row in curve))
    _write_events(folder / EVENTS_NAME, curve[-1:])


def load_picture_record(folder: Path) -> PictureRecord:
    """Read model.pt of a folder. Nothing in it is executed.

    Raises:
        InputError: not there, or no file of this kind.
    """

    def record_of(content: dict[str, Any]) -> PictureRecord:
        given = dict(content["settings"])
        weights, teaching = LossWeights(**given.pop("weights")), TeachingWeights(**given.pop("teaching"))
        return PictureRecord(
            settings=PictureTraining(**given, weights=weights, teaching=teaching),
            sources=dict(content["sources"]),
            curve=curve_of(content),
            kept=kept_of(content),
        )

    return read_model(folder, _FORMAT, record_of, made_by="learn_pose --pictures")


def _write_events(folder: Path, rows: Sequence[dict[str, int | float]]) -> None:
    try:
        writers: Any = importlib.import_module("torch.utils.tensorboard")
    except ImportError:
        return
    with writers.SummaryWriter(str(folder)) as writer:
        for row in rows:
            for name, value in row.items():
                if name != "step":
                    writer.add_scalar(name, value, int(row["step"]))
