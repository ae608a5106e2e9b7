"""`torchhand study design`: shipped studies by name, mistakes in one line."""

from pathlib import Path

import pytest

from torchhand.cli.command import DONE, WRONG_INPUT
from torchhand.cli.study import main

TINY = "factors: {observation: [points], dropout: [0, 0.5]}\ntrials: 2\npictures: 1\n"


def test_a_study_of_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib", reason="the plot needs matplotlib (extra study)")
    (tmp_path / "tiny.yaml").write_text(TINY, encoding="utf-8")
    words = ["design", str(tmp_path / "tiny.yaml"), "--out", str(tmp_path / "out"), "--trials", "1"]
    assert main(words) == DONE
    printed = capsys.readouterr().out
    assert "2 starts" in printed
    assert len((tmp_path / "out" / "study.csv").read_text().splitlines()) == 3
    assert main([*words, "--resume"]) == DONE
    assert "finished already" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nothing"], "nothing: no such study; expected a YAML file or one of calibration, hypotheses, observations"),
        (["observations", "--pictures", "900"], "pictures: expected 1 to 60, got 900"),
    ],
)
def test_mistakes_are_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], message: str
) -> None:
    assert main(["design", *words, "--out", str(tmp_path / "out")]) == WRONG_INPUT
    [line] = capsys.readouterr().err.splitlines()
    assert message in line
    assert not (tmp_path / "out").exists()
