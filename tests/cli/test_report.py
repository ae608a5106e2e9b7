"""`torchhand report`: one page of one result or two, and what users get wrong."""

from pathlib import Path

import pytest

from tests.report.made_result import write_result
from torchhand.cli.report import main


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("results")
    return write_result(folder / "one" / "wave"), write_result(folder / "two" / "wave", shift_deg=2.0, has_video=False)


def test_pages_lie_beside_their_results(results: tuple[Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    one, two = results
    assert main([str(one)]) == 0
    first = (one / "report.html").read_text(encoding="utf-8")
    assert f"saved {one / 'report.html'}" in capsys.readouterr().out
    assert main([str(one / "track.npz")]) == 0  # what a page holds is in the result: it is made anew
    assert (one / "report.html").read_text(encoding="utf-8") == first
    assert main([str(one), str(two)]) == 0
    page = (one / "comparison.html").read_text(encoding="utf-8")
    assert "A: one/wave" in page  # of two folders of one name the parent's tells which
    assert "B: two/wave" in page


def test_results_of_two_hands_are_told(
    results: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    left, page = write_result(tmp_path / "left", side="left", has_video=False), tmp_path / "page.html"
    assert main([str(results[1]), str(left), "--out", str(page)]) == 0
    told = "A and B differ: a right hand against a left one"
    assert f"note: {told}\n" in capsys.readouterr().out
    assert f"<p>{told}.</p>" in page.read_text(encoding="utf-8")


def test_a_file_that_is_there_stays(
    results: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "page.html"
    page.write_text("mine")
    assert main([str(results[0]), "--out", str(page)]) == 2
    assert "page.html: exists already; give another name, or --overwrite" in capsys.readouterr().err
    assert page.read_text() == "mine"
    assert main([str(results[0]), "--out", str(page), "--overwrite"]) == 0
    assert page.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["{one}", "{two}", "{one}"], "expected one result folder or two, got 3"),
        (["{one}", "nowhere"], "nowhere: no such file or folder"),
        (["{empty}"], "expected a folder with track.npz"),
        (["{one}", "--out", "{empty}"], "--out: expected a file, got the folder"),
        (["{one}", "--out", "{empty}/no/page.html"], "cannot be written (no such folder)"),
    ],
)
def test_mistakes_are_one_line(
    results: tuple[Path, Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    message: str,
) -> None:
    places = {"one": results[0], "two": results[1], "empty": tmp_path}
    assert main([argument.format(**places) for argument in arguments]) == 2
    told = capsys.readouterr().err
    assert message in " ".join(told.split())
    assert "Traceback" not in told
    assert not list(tmp_path.iterdir())
