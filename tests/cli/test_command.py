"""Exit codes and single lines: what every command does with success, mistakes, Ctrl-C and closed pipes."""

import logging
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import pytest
import torch
from tyro.conf import OmitArgPrefixes, Positional

from torchhand.cli.command import command, has_settings, parse, threads
from torchhand.cli.main import command_descriptions
from torchhand.cli.track import main as track
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


@dataclass(frozen=True, kw_only=True)
class Inner:
    depth: int = 1
    """How deep."""

    def __post_init__(self) -> None:
        if self.depth < 1:
            raise ValueError(f"--depth: expected 1 or more, got {self.depth}")


@dataclass(frozen=True, kw_only=True)
class Choices:
    """What it does."""

    side: Literal["right", "left"] | None = None
    """Which."""
    axes: Literal["x", "z", "y"] = "x"
    """Along which."""
    frames: int | None = None
    """How many."""
    share: float = 0.5
    """How much."""
    between: tuple[int, int] | None = None
    """First and last."""
    size: tuple[float, float] = (1.0, 2.0)
    """Two sides."""
    inner: OmitArgPrefixes[Inner] = Inner()
    """More."""


@command
def thing(argv: Sequence[str] | None = None) -> int:
    print(parse(Arguments, argv, name="thing").number)
    return 0


def test_success_is_zero(capsys: pytest.CaptureFixture[str]) -> None:
    assert thing(["3"]) == 0
    assert capsys.readouterr() == ("3\n", "")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--side both", "--side: expected left or right, got 'both'"),
        ("--axes w", "--axes: expected one of x, y, z, got 'w'"),
        ("--frames 1.5", "--frames: expected a whole number, got '1.5'"),
        ("--share half", "--share: expected a number, got 'half'"),
        ("--between 1 b", "--between: expected 2 whole numbers, got '1 b'"),
        ("--size big 2", "--size: expected 2 numbers, got 'big 2'"),
        ("--size 1", "--size: expected 2 values, got fewer"),
        ("--side", "--side: expected a value, got none"),
        ("--depth 0", "--depth: expected 1 or more, got 0"),
    ],
)
def test_mistakes_say_what_was_expected_and_what_was_given(words: str, message: str) -> None:
    with pytest.raises(InputError) as told:
        parse(Choices, words.split(), name="thing")
    assert str(told.value) == f"{message} (see torchhand thing --help)"


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
        (["three"], ["three", "expected a whole number, got 'three'"]),
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
    [
        ("", "expected a value after --out, got an empty argument"),
        ("a\udcff.mp4", r"a\xff.mp4: expected a name in UTF-8"),
    ],
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
    with pytest.raises(InputError, match="expected a value after --out=, got an empty argument"):
        parse(Arguments, ["--out="], name="test")


def test_a_file_whose_name_begins_with_a_dash_is_no_option(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    @dataclass(frozen=True, kw_only=True)
    class Arguments:
        """A command."""

        source: Positional[Path]

    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=r"^SOURCE: expected a value, got none"):
        parse(Arguments, ["-v.mp4"], name="test")
    for name in ("-v.mp4", "-v"):
        Path(name).touch()
    with pytest.raises(InputError, match=r"^-v\.mp4: expected \./-v\.mp4 for a file whose name begins with a dash$"):
        parse(Arguments, ["-v.mp4"], name="test")
    assert parse(Arguments, ["./-v.mp4", "-v"], name="test") == Arguments(source=Path("-v.mp4"))


@command
def talkative(argv: Sequence[str] | None = None) -> int:
    parse(Arguments, argv, name="thing")
    logging.getLogger("torchhand.runs.run").debug("frame 3: tracked, 40 ms")
    print("torchhand thing: a note", file=sys.stderr)
    print("torchhand thing: error: one of many videos", file=sys.stderr)
    print(f"result, a terminal: {sys.stderr.isatty()}")
    return 0


def test_a_command_tells_its_notes(capsys: pytest.CaptureFixture[str]) -> None:
    assert talkative(["3"]) == 0
    out, err = capsys.readouterr()
    assert out == "result, a terminal: False\n"
    assert err == "torchhand thing: a note\ntorchhand thing: error: one of many videos\n"


@pytest.mark.parametrize("word", ["--quiet", "-q"])
def test_a_quiet_command_tells_errors_alone(word: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert talkative(["3", word]) == 0
    out, err = capsys.readouterr()
    assert out.startswith("result")
    assert err == "torchhand thing: error: one of many videos\n"
    assert talkative(["3"]) == 0
    assert "a note" in capsys.readouterr().err, "only until the command ends"
    assert talkative(["three", word]) == 2
    assert capsys.readouterr().err.startswith(f"{NAME}: error: ")


def test_a_verbose_command_tells_the_log_and_its_memory(capsys: pytest.CaptureFixture[str]) -> None:
    assert talkative(["3", "--verbose"]) == 0
    err = capsys.readouterr().err
    assert " s  frame 3: tracked, 40 ms\n" in err
    assert "memory at most" in err
    assert talkative(["3"]) == 0
    assert "frame 3" not in capsys.readouterr().err, "only until the command ends"


def test_a_verbose_error_has_its_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    options = ["nowhere.mp4", "--out", "nowhere"]
    assert track(options) == 2
    assert "Traceback" not in capsys.readouterr().err
    assert track([*options, "-v"]) == 2
    err = capsys.readouterr().err
    assert "Traceback" in err
    assert err.splitlines()[-1].startswith("torchhand track: error: nowhere.mp4")


def test_quiet_and_verbose_exclude_each_other(capsys: pytest.CaptureFixture[str]) -> None:
    assert thing(["3", "-q", "-v"]) == 2
    assert "--quiet: expected no --verbose with it" in capsys.readouterr().err


def test_settings_are_printed_as_a_configuration_that_makes_them_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["nowhere.mp4", "--out", str(tmp_path / "out"), "--print-config"]
    assert track([*options, "--config", "contour_planar", "--set", "noise.rotation=80"]) == 0
    printed = capsys.readouterr().out
    assert "pose_space: planar\n" in printed
    assert "  rotation: 80.0\n" in printed
    (tmp_path / "own.yaml").write_text(printed)
    assert track([*options, "--config", str(tmp_path / "own.yaml")]) == 0
    assert capsys.readouterr().out == printed
    assert not (tmp_path / "out").exists()


def test_commands_with_settings_have_print_config() -> None:
    asked = {name for name in command_descriptions() if has_settings(f"torchhand.cli.{name}")}
    assert {"track", "track_multiview", "study"} <= asked
    assert "report" not in asked
    assert not any(has_settings(f"torchhand.cli.studies.{name}") for name in ("design", "ueda", "export"))


@dataclass(frozen=True, kw_only=True)
class _Replacing:
    """Write results."""

    given: Positional[tuple[str, ...]]
    hand: Path | None = None
    out: Path | None = None
    overlay: Path | None = None
    to: Path | None = None
    overwrite: bool = False


@pytest.mark.parametrize(
    ("words", "is_refused"),
    [
        (("out/overlay.mp4", "--out", "out"), True),
        (("clip.mp4", "--hand", "out/hand.json", "--out", "out"), True),
        (("clip.mp4", "out/overlays/one.png", "--out", "out"), True),
        (("out/clip.mp4", "--out", "out"), False),
        (("clip.mp4", "--hand", "out/hand.json", "--out", "other"), False),
        (("clip.mp4", "--out", "clip.mp4"), True),
        (("clip.mp4", "--out", "hand.json"), False),
        (("out", "--out", "out/hand.json"), True),
        (("out", "--out", "out/report.html"), False),
        (("clip.mp4", "--out", "new.json", "--overlay", "clip.mp4"), True),
        (("clip.mp4", "--hand", "hand.json", "--to", "hand.json"), True),
        (("out/overlay.mp4", "--to", "out/hand.json"), True),  # results are read with what stands beside them
        (("out/clip.mp4", "--to", "out/hand.json"), False),
    ],
)
def test_what_is_read_is_not_replaced(
    words: tuple[str, ...], is_refused: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out" / "overlays").mkdir(parents=True)
    (tmp_path / "other").mkdir()
    for name in ("clip.mp4", "hand.json", *(f"out/{own}" for own in ("overlay.mp4", "hand.json", "clip.mp4"))):
        (tmp_path / name).write_text("")
    (tmp_path / "out" / "overlays" / "one.png").write_text("")
    parse(_Replacing, words, name="thing")  # without --overwrite the commands refuse by themselves
    if not is_refused:
        parse(_Replacing, (*words, "--overwrite"), name="thing")
        return
    with pytest.raises(InputError, match=rf"{words[-2]}: expected a .* input, got"):
        parse(_Replacing, (*words, "--overwrite"), name="thing")
