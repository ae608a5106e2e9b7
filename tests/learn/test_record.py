"""Saved trainings: read back whole, and foreign files refused."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from torchhand.errors import InputError
from torchhand.files import load_hand_model
from torchhand.learn.data import SampleSettings
from torchhand.learn.estimate import estimate_hands
from torchhand.learn.record import CURVE_NAME, MODEL_NAME, load_record, save_record
from torchhand.learn.training import TrainingData, TrainingSettings, new_training, train

MODEL = load_hand_model()


def test_a_training_can_be_read_back(
    tmp_path: Path, small_settings: TrainingSettings, small_data: TrainingData
) -> None:
    settings = replace(small_settings, samples=SampleSettings(distance=(0.3, 0.9)))
    training = new_training(settings, MODEL, small_data)
    next(train(training, small_data, pause_every=3))
    curve = [{"step": 3, "loss": 1.25}, {"step": 6, "loss": 1 / 3}]
    save_record(tmp_path, training, curve)
    record = load_record(tmp_path)
    assert record.settings == settings
    assert record.curve == curve
    assert record.kept["step"] == 3
    assert (tmp_path / CURVE_NAME).read_text() == "step,loss\n3,1.25\n6,0.333333\n"
    points = 0.1 * torch.randn(5, 21, 2, generator=torch.Generator().manual_seed(0))
    network = record.network(MODEL)
    assert torch.equal(estimate_hands(network, points).keypoints, estimate_hands(training.network, points).keypoints)
    assert sorted(path.name for path in tmp_path.iterdir()) == [CURVE_NAME, MODEL_NAME]


def test_foreign_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"expected a folder with model.pt of an earlier training; there is none"):
        load_record(tmp_path)
    path = tmp_path / MODEL_NAME
    for content in (b"", b"no file of torch", b"PK\x03\x04 half a zip file", b"NaN"):
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"model.pt: expected a network saved by learn_pose"):
            load_record(tmp_path)
    for stored in ({"weights": torch.zeros(3)}, torch.zeros(3), {"format": "another"}, TrainingSettings()):
        torch.save(stored, path)
        with pytest.raises(InputError, match=r"model.pt: expected"):
            load_record(tmp_path)
