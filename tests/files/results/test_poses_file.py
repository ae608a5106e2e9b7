"""Results of single pictures replace older ones as one step."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from torchhand.errors import InputError
from torchhand.files import load_track
from torchhand.files.results import UNFINISHED_NAME, FrameRecord, PictureRecord, PosesWriter, TrackHeader
from torchhand.files.results.replacement import finish_replacement

HEADER = TrackHeader(dof_names=("x", "y"), source="pictures", side="right", camera={})


class _Stop(BaseException):
    """A kill, without upsetting the test runner."""


def _write(out: Path, name: str, *, has_overlay: bool = True, **options: bool) -> None:
    with PosesWriter(out, HEADER, ("length",), **options) as writer:
        hand = FrameRecord.empty(0, "no_hand", dofs=2, seconds=0.0)
        nothing = np.full((3, 3), np.nan)
        writer.append(PictureRecord(image=name, hand=hand, side="right", shape=np.ones(1), intrinsics=nothing))
        if has_overlay:
            (writer.overlays / f"{name}.png").write_text(name)


def _names(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("has_overlay", [True, False])
@pytest.mark.parametrize("steps", range(8))
def test_killed_at_any_step_the_folder_holds_one_result_or_the_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, steps: int, has_overlay: bool
) -> None:
    _write(tmp_path, "old")
    (tmp_path / "notes.txt").write_text("the user's own")
    left = [steps]

    marked = tmp_path / UNFINISHED_NAME / "complete.json"
    with monkeypatch.context() as patched:
        replace_file, unlink, rmdir = os.replace, Path.unlink, Path.rmdir

        def step() -> None:
            if marked.exists():  # from here on the new result counts
                if not left[0]:
                    raise _Stop
                left[0] -= 1

        patched.setattr(os, "replace", lambda *a: (step(), replace_file(*a))[1])
        patched.setattr(Path, "unlink", lambda *a, **o: (step(), unlink(*a, **o))[1])
        patched.setattr(Path, "rmdir", lambda *a: (step(), rmdir(*a))[1])
        try:
            _write(tmp_path, "new", has_overlay=has_overlay, overwrite=True)
        except _Stop:
            pass
        else:
            assert steps >= 5
    track = load_track(tmp_path)  # whoever reads it first finishes the moves
    assert track.image is not None
    assert track.image.tolist() == ["new"]
    assert json.loads((tmp_path / "poses.jsonl").read_text().splitlines()[0])["image"] == "new"
    overlays = {"overlays/new.png"} if has_overlay else set()
    assert _names(tmp_path) == {"header.json", "poses.npz", "poses.jsonl", "notes.txt"} | overlays


@pytest.mark.parametrize(
    "marker",
    [
        {"dropped": ["..", ".", "", "/etc/passwd", "../beside.txt", 5, None], "kept": ["../unfinished", {}]},
        {"dropped": 7, "kept": "poses.npz"},
        [1],
    ],
)
def test_a_foreign_marker_touches_nothing(tmp_path: Path, marker: object) -> None:
    out = tmp_path / "out"
    _write(out, "old")
    (tmp_path / "beside.txt").write_text("beside")
    (out / UNFINISHED_NAME).mkdir()
    (out / UNFINISHED_NAME / "complete.json").write_text(json.dumps(marker) + "\n")
    before = _names(tmp_path)
    finish_replacement(out, out / UNFINISHED_NAME)
    assert _names(tmp_path) == before - {"out/unfinished/complete.json"}


def test_what_lies_in_folders_of_an_overlay_folder_is_never_removed(tmp_path: Path) -> None:
    _write(tmp_path, "old")
    (tmp_path / "overlays" / "mine").mkdir()
    (tmp_path / "overlays" / "mine" / "notes.txt").write_text("the user's own")
    with pytest.raises(InputError, match=r"overlays/mine: cannot be removed .is a folder"):
        _write(tmp_path, "new", overwrite=True)
    assert (tmp_path / "overlays" / "mine" / "notes.txt").exists()


def test_overlays_of_something_else_are_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "overlays").mkdir()
    (tmp_path / "overlays" / "mine.png").write_text("mine")
    with pytest.raises(InputError, match="expected results of fit_pose to replace"):
        _write(tmp_path, "new", overwrite=True)
    assert _names(tmp_path) == {"overlays/mine.png"}
