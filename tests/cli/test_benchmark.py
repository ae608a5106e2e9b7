"""`torchhand benchmark`: figures as JSON and as a table, peers that are missing, memory of another process."""

import importlib
import json
import os
import subprocess
import sys
import time
import types
from pathlib import Path
from typing import Any

import pytest
import torch

from torchhand.cli import benchmark
from torchhand.cli.benchmark import Arguments, main
from torchhand.cli.benchmarks import Figure, Peer, line_of
from torchhand.cli.benchmarks import hand as benchmark_hand
from torchhand.cli.benchmarks import runs as benchmark_runs
from torchhand.cli.benchmarks import soak as benchmark_soak
from torchhand.evaluate import PROC, THREAD_VARIABLES, Timing, memory_growth, time_interleaved, watch_memory
from torchhand.files import load_hand_model
from torchhand.geometry import assumed_camera
from torchhand.hand import BONES
from torchhand.track import Estimate, Tracker, TrackerState, View

benchmark_tracking = importlib.import_module("torchhand.cli.benchmarks.tracking")  # the door's name is the function
KEYS = {"name", "ours_ms", "peer", "peer_ms", "ratio", "repeats", "unit", "value", "must", "aim", "meets", "details"}


@pytest.fixture(autouse=True)
def _in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in THREAD_VARIABLES:
        monkeypatch.setenv(name, "1")


def _run(out: Path, *options: str) -> dict[str, Any]:
    assert main(["--repeats", "1", "--out", str(out), *options]) == 0
    return json.loads(out.read_text())


def test_figures_are_saved_and_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("filterpy.kalman")
    found = _run(tmp_path / "figures.json", "--only", "filter_update")
    [entry] = found["entries"]
    assert entry.keys() >= KEYS
    assert (entry["name"], entry["peer"], entry["unit"]) == ("filter_update", "filterpy", "ratio")
    assert (entry["must"], entry["aim"], entry["repeats"]) == (10.0, 15.0, 1)
    assert entry["ratio"] == pytest.approx(entry["peer_ms"] / entry["ours_ms"])
    assert entry["value"] == entry["ratio"]
    assert entry["meets"] == (entry["ratio"] >= 10.0)
    assert entry["details"]["observed_27_ms"] > 0
    assert found["machine"]["torch_threads"] == 1
    assert found["machine"]["cpu_count"] == os.cpu_count()
    assert "filter_update" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("entry_name", "module", "peer"),
    [
        ("filter_update", "filterpy.kalman", "filterpy"),
        ("kinematics_forward", "pytorch_kinematics", "pytorch-kinematics"),
        ("kinematics_forward_backward", "pytorch_kinematics", "pytorch-kinematics"),
        ("skinning_gradients_64", "smplx.lbs", "smplx.lbs"),
    ],
)
def test_a_missing_peer_is_said_so(
    entry_name: str,
    module: str,
    peer: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    [entry] = _run(tmp_path / "figures.json", "--only", entry_name)["entries"]
    assert entry["ours_ms"] > 0
    assert entry["peer"] == peer
    assert [entry[key] for key in ("peer_ms", "ratio", "value", "meets")] == [None] * 4
    assert f"{peer} is not installed" in capsys.readouterr().out


def test_both_filters_compute_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """The peer is given the same problem, or the ratio would mean nothing."""
    pytest.importorskip("filterpy.kalman")
    given: dict[str, Any] = {}

    def keep(name: str, repeats: int, peer: Peer, candidates: dict[str, Any], *, must: float, aim: float) -> Figure:
        given.update(candidates)
        return Figure(name=name, value=None, unit="ratio", must=must, aim=aim, repeats=repeats)

    monkeypatch.setattr(benchmark_tracking, "against_peer", keep)
    benchmark_tracking.filter_update("filter_update", 1)
    ours = given["ours"]().state.mean.numpy()
    assert ours == pytest.approx(given["peer"](), abs=1e-9)
    assert ours == pytest.approx(given["observed_27"]().state.mean.numpy(), abs=1e-9)


def test_both_kinematics_compute_the_same() -> None:
    """The peer's chain gets the joint angles in its own order."""
    pose = benchmark_hand.poses(8)
    kinematics = load_hand_model().kinematics()
    peer = benchmark_hand.peer_chain(pose)
    assert peer is not None
    chain, angles = peer
    bone = "index_proximal"
    frames = kinematics(torch.cat((torch.zeros(8, 6), pose[:, 6:]), -1))
    theirs = chain.forward_kinematics(angles)[bone].get_matrix()[:, :3, :3]
    assert torch.allclose(frames.rotation[:, BONES.index(bone)], theirs, rtol=0, atol=1e-5)


def _slow_skinning(shape: torch.Tensor, pose: torch.Tensor, template: torch.Tensor, *_: Any) -> tuple[torch.Tensor]:
    """As many vertices as the peer makes, late."""
    time.sleep(0.2)
    count = benchmark_hand.PEER_VERTICES
    assert template.shape == (count, 3)
    assert pose.shape == (64, 48)
    return ((shape.sum(-1) + pose.sum(-1))[:, None, None].expand(-1, count, 3),)


def test_skinning_is_compared_per_vertex(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The peer's hand has fewer vertices: a call that takes as long is the worse."""
    peer = types.ModuleType("smplx.lbs")
    monkeypatch.setattr(peer, "lbs", _slow_skinning, raising=False)
    monkeypatch.setitem(sys.modules, "smplx", types.ModuleType("smplx"))
    monkeypatch.setitem(sys.modules, "smplx.lbs", peer)
    [entry] = _run(tmp_path / "figures.json", "--only", "skinning_gradients_64")["entries"]
    mesh = load_hand_model().mesh
    assert mesh is not None
    per_vertex = len(mesh.vertices) / benchmark_hand.PEER_VERTICES
    assert entry["peer_ms"] > 200
    assert entry["ratio"] == pytest.approx(per_vertex * entry["peer_ms"] / entry["ours_ms"])
    assert (entry["must"], entry["aim"]) == pytest.approx((1 / 0.7, 1 / 0.4))
    assert entry["note"] == f"per vertex; ours has {len(mesh.vertices)}, the peer {benchmark_hand.PEER_VERTICES}"
    assert entry["details"]["shape_each_ms"] > 0


def test_compiling_needs_a_compiler(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(benchmark_hand.shutil, "which", lambda name: None)
    [entry] = _run(tmp_path / "figures.json", "--only", "kinematics_compiled")["entries"]
    assert (entry["value"], entry["meets"], entry["must"], entry["aim"]) == (None, None, 6.0, 10.0)
    assert "C++ compiler" in entry["note"]


def _step_that_loses_every_third(
    tracker: Tracker, state: TrackerState | None, views: object, time_s: float
) -> tuple[TrackerState, Estimate]:
    number = 0 if state is None else state.frames_since_search + 1
    status = "lost" if number % 3 == 2 else "tracked"
    return TrackerState(frames_since_search=number), Estimate(status=status, time_s=time_s)


def test_a_trackers_speed_is_that_of_its_steps(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    camera = assumed_camera(16, 16)
    views = [View(image=torch.zeros(16, 16, 3, dtype=torch.uint8))] * 7
    monkeypatch.setattr(benchmark_tracking, "simulated_views", lambda *args: (camera, views))
    monkeypatch.setattr(Tracker, "step", _step_that_loses_every_third)
    [entry] = _run(tmp_path / "figures.json", "--only", "track_planar_360x288")["entries"]
    assert (entry["unit"], entry["must"], entry["aim"]) == ("frames/s", 60.0, 150.0)
    assert entry["value"] == pytest.approx(1e3 / entry["ours_ms"])
    assert (entry["peer"], entry["ratio"]) == (None, None)
    assert (entry["details"]["frames"], entry["details"]["tracked"]) == (6, 4)
    assert 0 < entry["details"]["cpu_ms_per_frame"] < 1e3
    assert "only 4 of 6 frames were tracked" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["track_planar_360x288", "track_full_640x480", "track_full_twice_points_640x480", "track_distance_640x480"]
)
def test_the_trackers_follow_what_they_are_timed_on(name: str, tmp_path: Path) -> None:
    [entry] = _run(tmp_path / "figures.json", "--only", name)["entries"]
    assert entry["details"]["tracked"] == entry["details"]["frames"] > 10


@pytest.mark.slow
def test_the_memory_of_tracking_is_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(benchmark_tracking, "MEMORY_FRAMES", 160)
    monkeypatch.setattr(benchmark_tracking, "MEMORY_RENDERED", 4)
    [entry] = _run(tmp_path / "figures.json", "--only", "track_memory")["entries"]
    assert 100 < entry["value"] < 1536
    assert entry["details"]["tracked"] > 150
    assert abs(entry["details"]["growth_mib_per_100_frames"]) < 20


def test_memory_is_slow_and_asked_for_by_name() -> None:
    assert "track_memory" not in Arguments().chosen
    assert Arguments(only=("track_memory",)).chosen == ("track_memory",)
    assert set(Arguments(everything=True).chosen) == set(benchmark._MEASURES)


def test_a_limit_that_is_not_met_is_said_so() -> None:
    figure = Figure(name="x", value=50.0, unit="frames/s", must=60.0, aim=150.0, ours_ms=20.0, repeats=1)
    assert figure.meets is False
    assert line_of(figure).endswith("50 frames/s   (must >= 60 frames/s, aim 150 frames/s) NOT MET")
    memory = Figure(name="x", value=900.0, unit="MiB", must=1536.0, repeats=1)
    assert memory.meets is True
    assert line_of(memory).endswith("(must < 1536 MiB)")


def test_ratios_are_taken_within_a_repeat() -> None:
    """The machine was ten times slower during the second repeat."""
    ours, theirs = Timing(milliseconds=(1.0, 10.0, 1.0)), Timing(milliseconds=(4.0, 50.0, 6.0))
    assert ours.faster_than(theirs) == pytest.approx(5.0)
    assert ours.median == 1.0


def test_candidates_take_turns() -> None:
    calls: list[str] = []
    times = time_interleaved({"a": lambda: calls.append("a"), "b": lambda: calls.append("b")}, 2, warm_up=1)
    assert "".join(calls) == "ababab"
    assert {name: len(timing.milliseconds) for name, timing in times.items()} == {"a": 2, "b": 2}


def test_growth_is_a_slope_per_hundred_frames() -> None:
    samples = [(frames, 500.0 + 0.03 * frames) for frames in range(0, 400, 10)]
    samples += [(390, 9000.0)] * 20  # what comes after the last frame
    assert memory_growth([(5, 4000.0), *samples], skip=100) == pytest.approx(3.0)
    assert memory_growth(samples[:5], skip=0) is None


def test_libraries_are_loaded_anew_for_other_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """numpy's library reads the number of its threads only once, and a peer must have as many as ours."""
    calls: list[tuple[list[str], dict[str, str]]] = []

    def run(call: list[str], *, env: dict[str, str], check: bool) -> subprocess.CompletedProcess[str]:
        calls.append((call, env))
        return subprocess.CompletedProcess(call, 0)

    monkeypatch.setattr(benchmark.subprocess, "run", run)
    options = ["--threads", "2", "--only", "filter_update"]
    assert main(options) == 0
    [(call, environment)] = calls
    assert call[-len(options) :] == options
    assert {environment[name] for name in THREAD_VARIABLES} == {"2"}


def test_memory_cannot_be_read_everywhere(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(benchmark_runs, "PROC", tmp_path / "proc")
    entries = _run(tmp_path / "figures.json", "--only", "track_memory", "track_views_memory")["entries"]
    assert [entry["name"] for entry in entries] == ["track_memory", "track_views_memory"]
    for entry in entries:
        assert (entry["value"], entry["meets"]) == (None, None)
        assert "does not have" in entry["note"]


@pytest.mark.skipif(not PROC.is_dir(), reason="needs /proc")
def test_memory_of_another_process() -> None:
    script = "import time; held = bytearray(200 << 20); time.sleep(0.3)"
    used = watch_memory([sys.executable, "-c", script], lambda: 7, skip=0, environment=os.environ, every_s=0.01)
    assert 200 < used.peak < 300
    assert (used.frames, used.growth) == (7, None)
    with pytest.raises(RuntimeError, match=r"exit code 3 .*of its own"):
        watch_memory(
            [sys.executable, "-c", "print('of its own'); raise SystemExit(3)"],
            lambda: 0,
            skip=0,
            environment=os.environ,
        )


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--only", "nothing"], "nothing"),
        (["--repeats", "0"], "--repeats: expected 1 to"),
        (["--threads", "0"], "--threads: expected 1 to"),
        (["--soak-steps", "0"], "--soak-steps: expected 1 to"),
        (["--soak-minutes", "0"], "--soak-minutes: expected above 0"),
        (["--out", "no/such/folder/figures.json"], "expected the name of a file in a folder that exists"),
    ],
)
def test_wrong_input_is_one_line_and_two(options: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(options) == 2
    output, errors = capsys.readouterr()
    assert output == ""
    assert errors.startswith("torchhand benchmark: error: ")
    assert words in errors
    assert errors.count("\n") == 1


@pytest.mark.skipif(not PROC.is_dir(), reason="needs /proc")
@pytest.mark.slow
def test_the_soak_is_two_figures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A few steps of filters and some seconds of tracking; both are slow and asked for by name."""
    monkeypatch.setattr(benchmark_soak, "_RENDERED", 3)
    monkeypatch.setattr(benchmark_soak, "_SAMPLES_S", 0.1)
    options = ["--only", "soak", "--soak-steps", "200", "--soak-minutes", "0.05"]
    filters, tracking = _run(tmp_path / "figures.json", *options)["entries"]
    assert (filters["name"], filters["unit"], filters["value"], filters["meets"]) == ("soak_filters", "faults", 0, True)
    assert sum(filters["details"]["steps"].values()) >= 200
    assert (tracking["name"], tracking["unit"], tracking["must"]) == ("soak_tracking", "MiB", 5.0)
    assert tracking["details"]["frames"] == sum(tracking["details"]["statuses"].values()) > 0
    assert not {"soak_filters", "soak_tracking"} & set(Arguments().chosen)
    assert Arguments(only=("soak",)).chosen == ("soak_filters", "soak_tracking")


@pytest.mark.slow
def test_a_tracker_that_goes_on_needs_no_more_memory(tmp_path: Path) -> None:
    [entry] = _run(tmp_path / "figures.json", "--only", "soak_tracking", "--soak-minutes", "3")["entries"]
    assert entry["meets"]
    assert entry["details"]["statuses"] == {"tracked": entry["details"]["frames"]}
