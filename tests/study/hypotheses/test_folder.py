"""The folder of a hypothesis study: batches that outlive the program, other studies refused, good results kept."""

from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.stops import Stop, stop_after
from torchhand.errors import InputError
from torchhand.study.hypotheses.folder import RESULT_NAMES, StudyFolder, load_study, save_study
from torchhand.study.hypotheses.record import Hypotheses

HEADER: dict[str, Any] = {"settings": {"starts": 6, "best_of": (1, 2), "far": float("inf")}, "seed": 3}


def batch(start: int, count: int = 3) -> Hypotheses:
    index = np.arange(start, start + count)
    plain = {f.name: index + 0.5 for f in fields(Hypotheses)}
    whole = {name: index for name in ("frame", "batch", "seed", "level", "iterations")}
    wide = {name: np.tile(index[:, None] / 7, size) for name, size in (("perturbation", 26), ("pose", 36))}
    return Hypotheses(**(plain | whole | wide | {"status": index % 4}))


def assert_same(one: Hypotheses | None, other: Hypotheses) -> None:
    assert one is not None
    for f in fields(Hypotheses):
        np.testing.assert_array_equal(getattr(one, f.name), getattr(other, f.name))


def begun(out: Path, *, resume: bool = False, overwrite: bool = False, header: dict[str, Any] = HEADER) -> StudyFolder:
    return StudyFolder(out, header, resume=resume, overwrite=overwrite)


def finish(folder: StudyFolder, text: str) -> None:
    with folder.finishing() as place:
        for name in RESULT_NAMES[:-1]:
            (place / name).write_text(text)
        save_study(
            place / RESULT_NAMES[-1], folder.header, Hypotheses.joined([batch(0), batch(3)], 6), {"more": [1, 2]}
        )


def test_batches_outlive_the_program(tmp_path: Path) -> None:
    first = begun(tmp_path / "out")
    first.batches.save(2, batch(0))
    first.batches.save(0, batch(3, 2))
    again = begun(tmp_path / "out", resume=True)
    assert again.finished is None
    assert [number in again.batches for number in range(4)] == [True, False, True, False]
    assert_same(again.batches.load(2), batch(0))
    assert_same(again.batches.load(0), batch(3, 2))


@pytest.mark.parametrize("left", [0, 10, 30, 100, 600, 1000])
def test_what_is_damaged_counts_as_none_and_is_written_anew(tmp_path: Path, left: int) -> None:
    folder = begun(tmp_path / "out")
    folder.batches.save(0, batch(0))
    whole = folder.batches.path.stat().st_size
    folder.batches.save(1, batch(3))
    path = folder.batches.path
    path.write_bytes(path.read_bytes()[: whole + left])
    again = begun(tmp_path / "out", resume=True)
    assert 0 in again.batches
    assert 1 not in again.batches
    again.batches.save(1, batch(4, 1))
    assert_same(begun(tmp_path / "out", resume=True).batches.load(1), batch(4, 1))


def test_a_flipped_bit_is_seen(tmp_path: Path) -> None:
    folder = begun(tmp_path / "out")
    folder.batches.save(0, batch(0))
    path = folder.batches.path
    content = bytearray(path.read_bytes())
    content[-300] ^= 1
    path.write_bytes(content)
    assert 0 not in begun(tmp_path / "out", resume=True).batches
    path.write_bytes(b"of another program")
    again = begun(tmp_path / "out", resume=True)
    again.batches.save(0, batch(1))
    assert_same(begun(tmp_path / "out", resume=True).batches.load(0), batch(1))


def test_finishing_leaves_the_results_alone(tmp_path: Path) -> None:
    folder = begun(tmp_path / "out")
    folder.batches.save(0, batch(0))
    (folder.folder / ".header.partial.json").write_bytes(b"what a killed program leaves")
    finish(folder, "new")
    assert {path.name for path in (tmp_path / "out").iterdir()} == set(RESULT_NAMES)
    header, found = load_study(tmp_path / "out" / "hypotheses.npz")
    assert header == folder.header
    assert_same(found, Hypotheses.joined([batch(0), batch(3)], 6))
    again = begun(tmp_path / "out", resume=True)
    assert_same(again.finished, found)
    assert {path.name for path in (tmp_path / "out").iterdir()} == set(RESULT_NAMES)


def test_the_same_study_has_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a.npz", "b.npz"):
        save_study(tmp_path / name, {"seed": 1}, batch(0), {"units": "m"})
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    with np.load(tmp_path / "a.npz") as stored:
        assert stored["status"].tolist() == ["converged", "stalled", "failed"]
        assert str(stored["units"]) == "m"


def test_an_older_result_stays_until_the_new_one_is_whole(tmp_path: Path) -> None:
    finish(begun(tmp_path), "old")
    with pytest.raises(InputError, match="the output folder exists and is not empty"):
        begun(tmp_path)
    other = begun(tmp_path, overwrite=True, header={"seed": 4})
    other.batches.save(0, batch(0))
    assert (tmp_path / "study.csv").read_text() == "old"
    other.discard()
    assert {path.name for path in tmp_path.iterdir()} == set(RESULT_NAMES)
    other = begun(tmp_path, overwrite=True, header={"seed": 4})
    other.batches.save(1, batch(3))
    resumed = begun(tmp_path, resume=True, header={"seed": 4})
    assert_same(resumed.batches.load(1), batch(3))
    finish(resumed, "new")
    assert (tmp_path / "study.csv").read_text() == "new"


@pytest.mark.parametrize("moves", range(len(RESULT_NAMES)))
def test_killed_between_two_moves_the_new_result_is_whole_at_the_next_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moves: int
) -> None:
    finish(begun(tmp_path), "old")
    other = begun(tmp_path, overwrite=True, header={"seed": 4})
    other.batches.save(0, batch(0))
    with monkeypatch.context() as patched:
        stop_after(moves, tmp_path, patched)
        with pytest.raises(Stop):
            finish(other, "new")
    again = begun(tmp_path, resume=True, header={"seed": 4})
    assert_same(again.batches.load(0), batch(0))
    header, _ = load_study(tmp_path / "hypotheses.npz")
    assert header["seed"] == 4
    assert {(tmp_path / name).read_text() for name in RESULT_NAMES[:-1]} == {"new"}


def test_starting_afresh_forgets_what_was_begun(tmp_path: Path) -> None:
    begun(tmp_path).batches.save(0, batch(0))
    assert 0 not in begun(tmp_path, overwrite=True).batches


def test_nothing_begun_leaves_nothing_when_discarded(tmp_path: Path) -> None:
    begun(tmp_path / "out").discard()
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("is_finished", [False, True])
def test_another_study_is_refused_by_name(is_finished: bool, tmp_path: Path) -> None:
    folder = begun(tmp_path)
    folder.batches.save(0, batch(0))
    if is_finished:
        finish(folder, "old")
    where = tmp_path / ("hypotheses.npz" if is_finished else "unfinished/header.json")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    for header, difference in (
        (HEADER | {"seed": 4}, "seed was 3, is now 4"),
        (HEADER | {"settings": {**HEADER["settings"], "starts": 7}}, "settings.starts was 6, is now 7"),
        (HEADER | {"new": 1}, "new was None, is now 1"),
    ):
        with pytest.raises(InputError) as refusal:
            begun(tmp_path, resume=True, header=header)
        assert str(refusal.value) == (
            f"{where}: cannot be resumed: {difference}; give the same options as before, or --overwrite"
        )
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_what_is_no_study_is_not_resumed(tmp_path: Path) -> None:
    assert begun(tmp_path / "new", resume=True).finished is None  # nothing there: a first run
    (tmp_path / "photo.jpg").write_text("mine")
    with pytest.raises(InputError, match=r"cannot be resumed: expected a study, found new"):
        begun(tmp_path, resume=True)
    with pytest.raises(InputError, match="expected at most one of --resume and --overwrite, got both"):
        begun(tmp_path, resume=True, overwrite=True)
    (tmp_path / "hypotheses.npz").write_bytes(b"PK")
    with pytest.raises(InputError, match=r"hypotheses.npz: is no hypothesis study that can be read"):
        begun(tmp_path, resume=True)


def test_another_program_s_arrays_are_no_study(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", header=np.array('{"format": "else"}'), status=np.array(["failed"]))
    with pytest.raises(InputError, match="expected the format 'torchhand hypothesis study 3', got 'else'"):
        load_study(tmp_path / "a.npz")
    np.savez(tmp_path / "b.npz", x=np.zeros(3))
    with pytest.raises(InputError, match=r"b.npz: is no hypothesis study that can be read \(KeyError: 'header"):
        load_study(tmp_path / "b.npz")
