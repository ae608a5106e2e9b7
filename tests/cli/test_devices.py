"""`--device` of every command that computes: one line for a device that is not there, before any work."""

import importlib
import pkgutil
from pathlib import Path

import pytest

import torchhand.cli
from torchhand.cli.command import OnDevice

GIVEN = {
    "benchmark": (),
    "fit_hand": ("picture.png", "--out", "hand.json"),
    "fit_keypoints": ("points.npy", "--out", "fit"),
    "fit_pose": ("pictures", "--out", "poses"),
    "learn_pose": ("--out", "network.npz"),
    "learn_proposals": ("--out", "network.npz"),
    "measure_quality": (),
    "measure_status": (),
    "simulate": ("--out", "sequence"),
    "simulate_crops": ("--out", "crops"),
    "study": ("--out", "study"),
    "track": ("video.mp4", "--out", "track"),
    "track_multiview": ("rig", "--out", "track"),
}


def test_every_command_on_a_device_is_among_those_tested() -> None:
    found = set()
    for module in (one for one in pkgutil.iter_modules(torchhand.cli.__path__) if not one.ispkg):
        record = getattr(importlib.import_module(f"torchhand.cli.{module.name}"), "Arguments", None)
        if isinstance(record, type) and issubclass(record, OnDevice):
            found.add(module.name)
    assert found == set(GIVEN)


@pytest.mark.parametrize("name", GIVEN)
def test_a_device_that_is_not_there(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    command = importlib.import_module(f"torchhand.cli.{name}")
    assert command.main([*GIVEN[name], "--device", "abacus"]) == 2
    error = capsys.readouterr().err.strip()
    assert error.startswith(f"torchhand {name}: error: --device: expected cpu")
    assert error.endswith("on this machine, got 'abacus'")
    assert not any(tmp_path.iterdir())


def test_what_is_measured_on_the_processor_alone(capsys: pytest.CaptureFixture[str]) -> None:
    command = importlib.import_module("torchhand.cli.benchmark")
    assert command.main(["--only", "octree_level7", "--device", "cuda"]) == 2
    assert "--device: expected cpu for octree_level7" in capsys.readouterr().err
