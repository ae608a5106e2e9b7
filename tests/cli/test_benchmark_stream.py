"""The measures of pose streams: what they say, and what they need."""

from pathlib import Path

import numpy as np
import pytest
import torch

from torchhand.cli.benchmarks import stream as benchmark_stream
from torchhand.cli.benchmarks.stream import recorded_poses, recorded_stream, synthetic_stream
from torchhand.files import load_hand_model
from torchhand.hand import DOFS


def _recording(path: Path) -> Path:
    """Two seconds of an index finger that bends, at 60 Hz, as a glove writes them."""
    rows = []
    for i in range(121):
        angles = np.zeros(23)
        angles[4] = -0.5 * i / 120  # the index's MCP joint; flexion is negative
        rows.append(f"2020 1 1 0 0 {i / 60:.4f} 1 " + " ".join(f"{a:.5f}" for a in angles))
    path.write_text("\n".join(rows))
    return path


def test_a_synthetic_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(benchmark_stream, "SECONDS", 8)
    monkeypatch.setattr(benchmark_stream, "STEPS_DEG", (2.0, 3.5, 9.0))
    figure = synthetic_stream("pose_stream", 1)
    assert (figure.unit, figure.must, figure.aim) == ("kbit/s", 2.0, 1.0)
    table = figure.details["table"]
    assert [row["step_deg"] for row in table] == [2.0, 3.5, 9.0]
    assert table[2]["mean_deg"] > 1 > table[1]["mean_deg"] > table[0]["mean_deg"]
    assert figure.value == table[1]["kbit_per_s"]  # the coarsest within a degree
    assert table[0]["kbit_per_s"] > table[1]["kbit_per_s"] > table[2]["kbit_per_s"]
    assert figure.note.count("kbit/s") == 3


def test_a_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(benchmark_stream, "STEPS_DEG", (3.5,))
    path = _recording(tmp_path / "glove.txt")
    poses = recorded_poses(load_hand_model(), path)
    assert poses.shape == (51, 36)
    bend = poses[:, DOFS.index("index_mcp_fe")]
    assert float((bend - torch.linspace(0, 0.5, 51, dtype=torch.float64)).abs().max()) < 1e-4
    figure = recorded_stream("pose_stream_recorded", 1, recordings=(path,))
    assert figure.details["dofs"] == {"glove": ["index_mcp_fe"]}
    assert 0 < figure.details["table"][0]["mean_deg"] < 1.2


def test_without_a_recording_it_says_so() -> None:
    figure = recorded_stream("pose_stream_recorded", None)
    assert figure.value is None
    assert figure.meets is None
    assert "needs a sensing glove's recording" in figure.note
