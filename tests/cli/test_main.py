"""The dispatcher: its list, its mistakes, and that it answers without loading torch."""

import importlib
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import torchhand
from torchhand.cli.command import arguments_of
from torchhand.cli.main import SHELLS, command_descriptions, main

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


@pytest.mark.parametrize("argv", [["--help"], ["track", "--help"], ["--version"], ["--completion", "bash"]])
def test_a_reader_that_leaves_is_no_mistake(argv: list[str]) -> None:
    """`torchhand track --help | head -1`: no traceback. The pipe is closed before anything is written."""
    start = f"import sys; sys.path.insert(0, {str(REPOSITORY)!r}); from torchhand.cli.main import main"
    program = f"{start}; sys.exit(main({argv}))"
    read_end, write_end = os.pipe()
    os.close(read_end)
    done = subprocess.run([sys.executable, "-c", program], stdout=write_end, stderr=subprocess.PIPE, text=True)
    os.close(write_end)
    assert (done.returncode, done.stderr) == (141, "")


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


@pytest.fixture(scope="module")
def helps_without_torch(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """What `--help` prints of every command, all in one process that must not load torch."""
    program = (
        f"import sys; sys.path.insert(0, {str(REPOSITORY)!r})\n"
        "from torchhand.cli.main import command_descriptions, main\n"
        "for name in command_descriptions():\n"
        "    print('\\f' + name)\n"
        "    main([name, '--help'])\n"
        "loaded = {'torch', 'numpy', 'cv2'} & set(sys.modules)\n"
        "sys.exit(', '.join(loaded) or 0)\n"
    )
    folder = tmp_path_factory.mktemp("helps")
    done = subprocess.run([sys.executable, "-c", program], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, f"loaded for help: {done.stderr}"
    return dict(part.split("\n", 1) for part in done.stdout.split("\f")[1:])


@pytest.mark.parametrize("name", command_descriptions())
def test_help_needs_no_torch_and_says_what_the_command_says(
    name: str, helps_without_torch: dict[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    """Made from the arguments alone, the help is that of the command as a whole."""
    assert importlib.import_module(f"torchhand.cli.{name}").main(["--help"]) == 0
    assert _words(helps_without_torch[name]) == _words(capsys.readouterr().out)


def _words(text: str) -> str:
    """Without spaces and frames, which are others in another terminal."""
    return re.sub(r"[\s│╭╮╰╯|─+-]", "", text)


def test_a_record_that_needs_more_is_left_to_the_whole_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torchhand, "__path__", [str(tmp_path)])
    (tmp_path / "light.py").write_text("import torch\nSIZE = 3\nclass Arguments:\n    size: int = SIZE\n")
    (tmp_path / "heavy.py").write_text("import torch\nclass Arguments:\n    size: int = torch.get_num_threads()\n")
    light = arguments_of("torchhand.light")
    assert light is not None
    assert vars(light)["size"] == 3
    assert arguments_of("torchhand.heavy") is None


def test_the_module_is_the_command(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "torchhand", "--version"]
    done = subprocess.run(words, cwd=REPOSITORY, capture_output=True, text=True)
    assert done.stdout == f"torchhand {torchhand.__version__}\n"


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")
@pytest.mark.parametrize(
    ("words", "expected"),
    [(["fit_k"], "fit_keypoints"), (["track", "--keep-"], "--keep-checkpoint"), (["track", "--side", "le"], "left")],
)
def test_bash_completes(words: list[str], expected: str, completion: Path) -> None:
    line = " ".join(["torchhand", *words])
    asks = (
        f"source {completion}; COMP_LINE='{line}'; COMP_POINT={len(line)}; "
        f"COMP_WORDS=(torchhand {' '.join(words)}); COMP_CWORD={len(words)}; "
        "$(complete -p torchhand | sed 's/.*-F \\([^ ]*\\).*/\\1/') torchhand; printf '%s\\n' \"${COMPREPLY[@]}\""
    )
    done = subprocess.run(["bash", "-c", asks], capture_output=True, text=True)
    assert expected in done.stdout.split(), done.stderr


@pytest.fixture(scope="module")
def completion(tmp_path_factory: pytest.TempPathFactory) -> Path:
    words = [sys.executable, "-m", "torchhand", "--completion", "bash"]
    done = subprocess.run(words, cwd=REPOSITORY, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    script = tmp_path_factory.mktemp("completion") / "torchhand.bash"
    script.write_text(done.stdout)
    return script


@pytest.mark.parametrize("shell", SHELLS)
def test_every_shell_that_is_named_gets_a_script(shell: str) -> None:
    words = [sys.executable, "-m", "torchhand", "--completion", shell]
    done = subprocess.run(words, cwd=REPOSITORY, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "keep-checkpoint" in done.stdout


def test_another_shell_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--completion", "cmd"]) == 2
    assert capsys.readouterr().err == "torchhand: error: --completion: expected one of bash, zsh, fish\n"
