"""Parts of a study on disk: kept one by one, gone on with, and never mixed up with another study."""

from pathlib import Path

import pytest

from tests.stops import Stop, stop_after
from torchhand.errors import InputError
from torchhand.study.ueda.folder import PARTS_NAME, PartsFolder

NAMES = ("table.csv", "figure.png")


def test_parts_survive_and_results_move_into_place(tmp_path: Path) -> None:
    first = PartsFolder(tmp_path / "out", {"seed": 1})
    first.save("one", {"value": 1.5})
    again = PartsFolder(tmp_path / "out", {"seed": 1}, resume=True)
    assert again.parts == {"one": {"value": 1.5}}
    again.save("two-b", [1, 2])
    with again.finishing(NAMES) as place:
        (place / "table.csv").write_text("a\n")
        assert not (tmp_path / "out" / "table.csv").exists()
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [PARTS_NAME, "table.csv"]
    finished = PartsFolder(tmp_path / "out", {"seed": 1}, resume=True)
    assert finished.parts == {"one": {"value": 1.5}, "two-b": [1, 2]}


def test_an_older_result_stays_until_the_new_one_is_there(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with PartsFolder(out, {"seed": 1}).finishing(NAMES) as place:
        (place / "table.csv").write_text("old\n")
    newer = PartsFolder(out, {"seed": 2}, overwrite=True)
    newer.save("one", 1)

    def break_off() -> None:
        with newer.finishing(NAMES) as place:
            (place / "table.csv").write_text("half\n")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        break_off()
    assert (out / "table.csv").read_text() == "old\n"
    whole = PartsFolder(out, {"seed": 2}, resume=True)
    assert whole.parts == {"one": 1}
    with whole.finishing(NAMES) as place:
        (place / "table.csv").write_text("new\n")
    assert (out / "table.csv").read_text() == "new\n"


@pytest.mark.parametrize("moves", range(2))
def test_killed_between_two_moves_the_new_result_is_whole_at_the_next_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moves: int
) -> None:
    out = tmp_path / "out"
    with PartsFolder(out, {"seed": 1}).finishing(NAMES) as place:
        for name in NAMES:
            (place / name).write_text("old")
    folder = PartsFolder(out, {"seed": 2}, overwrite=True)
    folder.save("one", 1)

    def finish() -> None:
        with folder.finishing(NAMES) as place:
            (place / "table.csv").write_text("new")

    with monkeypatch.context() as patched:
        stop_after(moves, out, patched)
        with pytest.raises(Stop):
            finish()
    again = PartsFolder(out, {"seed": 2}, resume=True)
    assert again.parts == {"one": 1}
    assert (out / "table.csv").read_text() == "new"
    assert not (out / "figure.png").exists()


def test_another_study_is_not_gone_on_with(tmp_path: Path) -> None:
    PartsFolder(tmp_path / "begun", {"seed": 1}).save("one", 1)
    with pytest.raises(InputError, match=r"header\.json: cannot be resumed: seed was 1, is now 2; give the same"):
        PartsFolder(tmp_path / "begun", {"seed": 2}, resume=True)
    with PartsFolder(tmp_path / "done", {"seed": 1}).finishing(NAMES):
        pass
    with pytest.raises(InputError, match=r"parts\.json: cannot be resumed: seed was 1, is now 2"):
        PartsFolder(tmp_path / "done", {"seed": 2}, resume=True)
    with pytest.raises(InputError, match="not empty"):
        PartsFolder(tmp_path / "done", {"seed": 1})
    (tmp_path / "foreign").mkdir()
    (tmp_path / "foreign" / "notes.txt").write_text("")
    with pytest.raises(InputError, match=r"cannot be resumed: expected a study, found notes\.txt"):
        PartsFolder(tmp_path / "foreign", {"seed": 1}, resume=True)
    (tmp_path / "done" / PARTS_NAME).write_text("[]")
    with pytest.raises(InputError, match="expected the parts of a study"):
        PartsFolder(tmp_path / "done", {"seed": 1}, resume=True)
