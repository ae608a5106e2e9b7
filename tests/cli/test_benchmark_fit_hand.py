"""`torchhand benchmark` on fitting a hand: whose bones are compared, and what is said of those who are refused."""

import json
from pathlib import Path

import pytest
import torch

from torchhand.cli.benchmark import Arguments, main
from torchhand.cli.benchmarks import fit_hand as benchmark_fit_hand
from torchhand.cli.benchmarks.fit_hand import BONES, bone_lengths, fit_hand_bones, pictures
from torchhand.evaluate import THREAD_VARIABLES
from torchhand.files import load_hand_model
from torchhand.hand import posture
from torchhand.image import NoRegions


@pytest.fixture(autouse=True)
def _small_and_in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in THREAD_VARIABLES:
        monkeypatch.setenv(name, "1")
    monkeypatch.setattr(benchmark_fit_hand, "SIZE_PX", (320, 240))


def test_bones_are_the_shape_s_own() -> None:
    model = load_hand_model()
    kinematics = model.kinematics("right", dtype=torch.float64)
    found = bone_lengths(kinematics(posture("open", dtype=torch.float64)).keypoints)
    metric = model.shape_space.metric(kinematics.default_shape)
    assert float(found[BONES.index((9, 10))]) == pytest.approx(float(metric["middle_proximal"]))
    assert float(found[BONES.index((1, 2))]) == pytest.approx(float(metric["thumb_metacarpal"]))
    assert len(found) == 19


def test_people_differ_and_the_same_ones_come_again() -> None:
    first, second = pictures(2)
    [again] = pictures(1)
    assert bool((first.image == again.image).all())
    assert (first.kinematics.side, second.kinematics.side) == ("right", "left")
    assert float((first.bones - second.bones).abs().max()) > 0.001
    assert first.hand_length != second.hand_length


def test_one_person_s_bones(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "figures.json"
    assert main(["--repeats", "1", "--out", str(out), "--only", "fit_hand_bones"]) == 0
    [entry] = json.loads(out.read_text())["entries"]
    assert 0 < entry["details"]["median"] < entry["value"] < 25
    assert entry["details"]["fitted"] == entry["details"]["people"] == 1
    assert "1 of 1 people fitted" in capsys.readouterr().out


def test_refused_people_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    refused = NoRegions(reason="no hand", found=())
    monkeypatch.setattr(benchmark_fit_hand, "fit_open_hand", lambda *_, **__: refused)
    figure = fit_hand_bones("fit_hand_bones", 1)
    assert figure.value is None
    assert figure.meets is None
    assert "0 of 1 people fitted" in figure.note


def test_it_is_measured_by_name_or_with_all() -> None:
    assert "fit_hand_bones" not in Arguments().chosen
    assert "fit_hand_bones" in Arguments(everything=True).chosen
