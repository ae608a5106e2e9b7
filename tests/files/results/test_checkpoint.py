"""Checkpoints: exact, bound to their run, and never half believed."""

import errno
from pathlib import Path
from typing import Any

import pytest
import torch

from torchhand.errors import DiskError
from torchhand.files.results.checkpoint import ResumePoint, load_checkpoint, save_checkpoint

HEADER = {"source": "wave.mp4", "made_with": {"seed": 0}}


def _point(**state: Any) -> ResumePoint:
    return ResumePoint(last_frame=7, state={"mean": torch.arange(36.0), "name": "contour", **state})


def test_a_checkpoint_comes_back(tmp_path: Path):
    save_checkpoint(tmp_path / "checkpoint.pt", _point(), HEADER)
    point, problem = load_checkpoint(tmp_path / "checkpoint.pt", HEADER)
    assert point is not None
    assert (point.last_frame, problem, point.state["name"]) == (7, "", "contour")
    assert torch.equal(point.state["mean"], torch.arange(36.0))


def test_every_flipped_bit_is_found(tmp_path: Path):
    path = tmp_path / "checkpoint.pt"
    save_checkpoint(path, _point(), HEADER)
    whole = path.read_bytes()
    for place in range(0, len(whole), 37):
        damaged = bytearray(whole)
        damaged[place] ^= 1 << place % 8
        path.write_bytes(damaged)
        assert load_checkpoint(path, HEADER) == (None, f"{path}: is damaged, or no checkpoint of this version")
    path.write_bytes(whole[:-1])
    assert load_checkpoint(path, HEADER)[0] is None
    path.write_bytes(b"")
    assert load_checkpoint(path, HEADER)[0] is None


@pytest.mark.parametrize("content", [{}, [1], {"last_frame": 7}, {"last_frame": 7, "state": {}}, None, "text"])
def test_well_formed_files_of_others_are_refused(tmp_path: Path, content: Any):
    path = tmp_path / "checkpoint.pt"
    torch.save(content, path)
    assert load_checkpoint(path, HEADER)[0] is None


def test_the_checkpoint_of_another_run_is_refused(tmp_path: Path):
    path = tmp_path / "checkpoint.pt"
    save_checkpoint(path, _point(), HEADER)
    assert load_checkpoint(path, {**HEADER, "source": "other.mp4"}) == (
        None,
        f"{path}: is the checkpoint of another run",
    )


def test_a_full_disk_keeps_the_checkpoint_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "checkpoint.pt"
    save_checkpoint(path, _point(), HEADER)

    def full(self: Path, data: bytes) -> int:
        with self.open("wb") as file:
            file.write(data[: len(data) // 2])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(DiskError, match=r"checkpoint.pt: cannot be written \(no space left on the disk\)"):
        save_checkpoint(path, _point(name="later"), HEADER)
    point, _ = load_checkpoint(path, HEADER)
    assert point is not None
    assert point.state["name"] == "contour"
    assert [entry.name for entry in tmp_path.iterdir()] == ["checkpoint.pt"]
