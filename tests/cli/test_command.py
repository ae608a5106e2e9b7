"""Exit codes and single lines: what every command does with success, mistakes, Ctrl-C and closed pipes."""

import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest
import torch
from tyro.conf import Positional

from torchhand.cli.command import command, parse, threads
from torchhand.errors import InputError

NAME = f"torchhand {__name__.rpartition('.')[2]}"


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """What it does.

    Example:
        torchhand thing 3
    """

    number: Positional[int]
    """How many."""
    fraction: float = 0.5
    """Between 0 and 1."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.fraction <= 1.0:
            raise ValueError(f"fraction: expected 0 to 1, got {self.fraction}")


@command
def thing(argv: Sequence[str] | None = None) -> int:
    print(parse(Arguments, argv, name="thing").number)
    return 0


def test_success_is_zero(capsys: pytest.CaptureFixture[str]) -> None:
    assert thing(["3"]) == 0
    assert capsys.readouterr() == ("3\n", "")


def test_help_shows_the_example(capsys: pytest.CaptureFixture[str]) -> None:
    assert thing(["--help"]) == 0
    text = capsys.readouterr().out
    assert "usage: torchhand thing" in text
    assert "Example:\n    torchhand thing 3\n" in text
    assert "Between 0 and 1." in text


@pytest.mark.parametrize(
    ("argv", "expected"),
    [
        ([], ["Missing", "INT"]),
        (["3", "--frction", "1"], ["Unrecognized options: --frction", "--fraction"]),
        (["three"], ["three", "int"]),
        (["3", "--fraction", "2"], ["fraction: expected 0 to 1, got 2.0"]),
    ],
)
def test_usage_errors_are_one_line_and_two(
    argv: list[str], expected: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert thing(argv) == 2
    output, errors = capsys.readouterr()
    assert output == ""
    assert errors.startswith(f"{NAME}: error: ")
    assert errors.count("\n") == 1
    assert not set("│╭╰─") & set(errors)
    for part in expected:
        assert part in errors


@pytest.mark.parametrize(
    ("error", "code", "line"),
    [
        (InputError("config.yaml: unknown key\n'gain'"), 2, "error: config.yaml: unknown key 'gain'"),
        (PermissionError(13, "Permission denied", "/out/track.npz"), 2, "error: /out/track.npz: Permission denied"),
        (OSError(28, "No space left on device"), 1, "error: [Errno 28] No space left on device"),
        (KeyboardInterrupt(), 130, "stopped by Ctrl-C"),
    ],
)
def test_errors_become_one_line(error: BaseException, code: int, line: str, capsys: pytest.CaptureFixture[str]) -> None:
    @command
    def broken(argv: Sequence[str] | None = None) -> int:
        raise error

    assert broken([]) == code
    assert capsys.readouterr() == ("", f"{NAME}: {line}\n")


def test_our_own_mistakes_keep_their_traceback() -> None:
    @command
    def broken(argv: Sequence[str] | None = None) -> int:
        raise ValueError("shape mismatch")

    with pytest.raises(ValueError, match="shape mismatch"):
        broken([])


def test_a_closed_pipe_is_quiet(tmp_path: Path) -> None:
    program = tmp_path / "endless.py"
    program.write_text(
        "import sys\n"
        "from torchhand.cli.command import command\n"
        "@command\n"
        "def main(argv=None):\n"
        "    while True:\n"
        "        print('line')\n"
        "sys.exit(main())\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[2])}
    with subprocess.Popen(
        [sys.executable, str(program)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.readline() == b"line\n"
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait(timeout=30) == 141


def test_threads_hold_inside_the_block_only() -> None:
    before = torch.get_num_threads()
    seen = []

    def fail() -> None:
        with threads(before + 1):
            seen.append(torch.get_num_threads())
            raise RuntimeError("inside")

    with pytest.raises(RuntimeError, match="inside"):
        fail()
    assert seen == [before + 1]
    assert torch.get_num_threads() == before


@pytest.mark.parametrize("count", [0, -1, 1025])
def test_a_number_of_threads_that_cannot_be(count: int) -> None:
    with pytest.raises(InputError, match=f"^--threads: expected 1 to 1024, got {count}$"), threads(count):
        pass


@pytest.mark.parametrize(
    ("word", "complaint"),
    [("", "expected a value, got an empty argument"), ("a\udcff.mp4", r"a\xff.mp4: expected a name in UTF-8")],
)
def test_words_that_name_nothing_are_refused(word: str, complaint: str) -> None:
    @dataclass(frozen=True, kw_only=True)
    class Arguments:
        """A command."""

        out: Path

    assert parse(Arguments, ["--out", "a"], name="test") == Arguments(out=Path("a"))
    with pytest.raises(InputError) as caught:
        parse(Arguments, ["--out", word], name="test")
    assert complaint in str(caught.value)
