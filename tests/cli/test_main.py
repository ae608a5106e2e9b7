"""The dispatcher: its list, its mistakes, and that it answers without loading torch."""

import subprocess
import sys
from pathlib import Path

import pytest

import torchhand
from torchhand.cli.main import command_descriptions, main

REPOSITORY = Path(__file__).resolve().parents[2]


def test_every_command_file_is_listed_with_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    descriptions = command_descriptions()
    assert "evaluate" in descriptions
    assert not {"main", "command", "__main__"} & set(descriptions)
    assert main(["--help"]) == 0
    text = capsys.readouterr().out
    for name, description in descriptions.items():
        assert description.endswith("."), f"{name}: the docstring's first line is the command's description"
        assert f"  {name}" in text
        assert description in text


def test_every_script_is_its_command() -> None:
    for name in command_descriptions():
        script = REPOSITORY / "scripts" / f"{name}.py"
        if script.exists():
            assert f"from torchhand.cli.{name} import main" in script.read_text(), script


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"torchhand {torchhand.__version__}\n"


@pytest.mark.parametrize(
    ("argv", "line"),
    [
        (["evaluat"], "torchhand: error: unknown command 'evaluat'; did you mean 'evaluate'?"),
        (["xyzzy"], "torchhand: error: unknown command 'xyzzy'; allowed: "),
        ([], "usage: torchhand COMMAND"),
    ],
)
def test_a_wrong_call_is_two(argv: list[str], line: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(argv) == 2
    output, errors = capsys.readouterr()
    assert output == ""
    assert errors.startswith(line)


def test_the_list_appears_without_loading_torch(tmp_path: Path) -> None:
    program = (
        f"import sys; sys.path.insert(0, {str(REPOSITORY)!r}); from torchhand.cli.main import main; main(['--help']); "
        "sys.exit('torch' in sys.modules or 'numpy' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True).returncode == 0


def test_a_script_runs_from_any_folder(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, str(REPOSITORY / "scripts" / "evaluate.py"), "nowhere", "nothing"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2
    assert done.stderr == (
        "torchhand evaluate: error: nowhere: expected the result folder of `torchhand track`; there is none\n"
    )
