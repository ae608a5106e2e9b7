"""What a training leaves in its folder: the network with all that is needed to go on, and the curve."""

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar

import torch

from torchhand.errors import InputError
from torchhand.files.disk import replacing, write_text
from torchhand.hand import HandModel
from torchhand.learn.data import SampleSettings
from torchhand.learn.network import PoseNetwork
from torchhand.learn.training import LossWeights, Training, TrainingSettings, snapshot

MODEL_NAME, CURVE_NAME = "model.pt", "curve.csv"
MODEL_FORMAT = "torchhand learn_pose 1"
_Record = TypeVar("_Record")

Curve = list[dict[str, int | float]]
"""One row for every time that was measured: step, loss, and the figures on held-out hands."""


@dataclass(frozen=True, kw_only=True)
class TrainingRecord:
    """A saved training."""

    settings: TrainingSettings
    curve: Curve
    kept: dict[str, Any]
    """State of the training, as `training.restored` takes it."""

    def network(self, model: HandModel) -> PoseNetwork:
        """The network as it was saved, to be used."""
        settings = self.settings
        network = PoseNetwork(model, torch.zeros(30), width=settings.width, blocks=settings.blocks)
        network.load_state_dict(self.kept["network"])
        return network.eval()


def save_record(folder: Path, training: Training, curve: Curve) -> None:
    """Write model.pt and curve.csv, each whole or not at all."""
    content = {"format": MODEL_FORMAT, "settings": asdict(training.settings), "curve": curve, **snapshot(training)}
    write_model(folder, content)
    write_text(folder / CURVE_NAME, curve_text(curve))


def load_record(folder: Path) -> TrainingRecord:
    """Read model.pt of a folder. Nothing in it is executed.

    Raises:
        InputError: not there, or no file of this kind.
    """

    def record_of(content: dict[str, Any]) -> TrainingRecord:
        given = dict(content["settings"])
        samples, weights = SampleSettings(**given.pop("samples")), LossWeights(**given.pop("weights"))
        settings = TrainingSettings(**given, samples=samples, weights=weights)
        return TrainingRecord(settings=settings, curve=curve_of(content), kept=kept_of(content))

    return read_model(folder, MODEL_FORMAT, record_of, made_by="learn_pose")


def write_model(folder: Path, content: dict[str, Any]) -> None:
    """Write model.pt, whole or not at all."""
    packed = io.BytesIO()  # torch's writer hides why a disk refuses
    torch.save(content, packed)
    with replacing(folder / MODEL_NAME) as temporary:
        temporary.write_bytes(packed.getvalue())


def read_model(folder: Path, kind: str, record_of: Callable[[dict[str, Any]], _Record], *, made_by: str) -> _Record:
    """What `record_of` makes of the content of a folder's model.pt, whose format is `kind`. Nothing in it is executed.

    record_of: raises KeyError, TypeError or ValueError for content that is none of its own. made_by: the command.
    Raises InputError where there is no such file, or none of this kind.
    """
    path = folder / MODEL_NAME
    if not path.is_file():
        raise InputError(f"{folder}: expected a folder with {MODEL_NAME} of an earlier training; there is none")
    complaint = f"{path}: expected a network saved by {made_by}; it cannot be read as one"
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # the reader raises whatever it stumbles over
        raise InputError(complaint) from error
    try:
        if not isinstance(content, dict) or content["format"] != kind:
            raise ValueError(f"expected a mapping of the format {kind!r}")
        return record_of(content)
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(complaint) from error


def curve_of(content: dict[str, Any]) -> Curve:
    """The curve in the content of a model.pt."""
    return [dict(row) for row in content["curve"]]


def kept_of(content: dict[str, Any]) -> dict[str, Any]:
    """The state of network and optimiser, and the step, in the content of a model.pt."""
    return {name: content[name] for name in ("step", "network", "optimiser")}


def curve_text(curve: Curve) -> str:
    """The curve as comma-separated values with a line of names."""
    text = io.StringIO()
    names: Sequence[str] = list(curve[0]) if curve else ["step", "loss"]
    table = csv.DictWriter(text, names, lineterminator="\n")
    table.writeheader()
    table.writerows({name: f"{value:.6g}" for name, value in row.items()} for row in curve)
    return text.getvalue()
