"""What a training from pictures leaves in its folder: the network with all that is needed to go on, and its log."""

import importlib
import io
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch

from torchhand.errors import InputError
from torchhand.files.disk import replacing, write_text
from torchhand.hand import HandModel
from torchhand.learn import CURVE_NAME, MODEL_NAME, Curve, LossWeights, curve_text
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
        "step": training.step,
        "network": training.network.state_dict(),
        "optimiser": training.optimiser.state_dict(),
    }
    packed = io.BytesIO()  # torch's writer hides why a disk refuses
    torch.save(content, packed)
    with replacing(folder / MODEL_NAME) as temporary:
        temporary.write_bytes(packed.getvalue())
    write_text(folder / CURVE_NAME, curve_text(curve))
    write_text(folder / LOG_NAME, "".join(json.dumps(row) + "\n" for row in curve))
    _write_events(folder / EVENTS_NAME, curve[-1:])


def load_picture_record(folder: Path) -> PictureRecord:
    """Read model.pt of a folder. Nothing in it is executed.

    Raises:
        InputError: not there, or no file of this kind.
    """
    path = folder / MODEL_NAME
    if not path.is_file():
        raise InputError(f"{folder}: expected a folder with {MODEL_NAME} of an earlier training; there is none")
    complaint = f"{path}: expected a network saved by learn_pose --pictures; it cannot be read as one"
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # the reader raises whatever it stumbles over
        raise InputError(complaint) from error
    try:
        if not isinstance(content, dict) or content["format"] != _FORMAT:
            raise ValueError(f"expected a mapping of the format {_FORMAT!r}")
        given = dict(content["settings"])
        weights, teaching = LossWeights(**given.pop("weights")), TeachingWeights(**given.pop("teaching"))
        return PictureRecord(
            settings=PictureTraining(**given, weights=weights, teaching=teaching),
            sources=dict(content["sources"]),
            curve=[dict(row) for row in content["curve"]],
            kept={name: content[name] for name in ("step", "network", "optimiser")},
        )
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(complaint) from error


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
