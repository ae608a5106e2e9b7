"""Settings: differences from YAML and from the command line, and every way to get them wrong."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import pytest
import yaml

from torchhand import __version__
from torchhand.errors import InputError
from torchhand.files.settings import load_settings, save_settings
from torchhand.track import DEFAULTS


@dataclass(frozen=True, kw_only=True)
class Filter:
    order: Literal[0, 1, 2] = 2
    noise_px: float = 1.5
    is_robust: bool = False
    gate: float | None = None

    def __post_init__(self) -> None:
        if self.noise_px <= 0:
            raise ValueError(f"noise_px: expected more than 0, got {self.noise_px}")


@dataclass(frozen=True, kw_only=True)
class Step:
    length: float
    count: int = 1

    def __post_init__(self) -> None:
        if self.length <= 0:
            raise ValueError(f"length: expected more than 0, got {self.length}")


@dataclass(frozen=True, kw_only=True)
class Options:
    space: str = "planar"
    steps: int = 3
    range_deg: tuple[float, float] = (-10.0, 10.0)
    fingers: tuple[str, ...] = ()
    background: Path | None = None
    weights: dict[str, float] = field(default_factory=dict)
    filter: Filter = field(default_factory=Filter)
    stages: tuple[Filter, ...] = (Filter(), Filter(order=1))
    walk: tuple[Step, ...] = (Step(length=2.0),)


def _write(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def test_a_file_holds_differences_only(tmp_path: Path):
    text = """
space: full
steps: 5
range_deg: [-20, 2.5e+1]
fingers: [index, ring]
background: plate.png
weights: {edge: 2}
filter:
  order: 1
  noise_px: 1e-3
"""
    settings = load_settings(Options(), _write(tmp_path / "a.yaml", text))
    assert settings == Options(
        space="full",
        steps=5,
        range_deg=(-20.0, 25.0),
        fingers=("index", "ring"),
        background=Path("plate.png"),
        weights={"edge": 2.0},
        filter=Filter(order=1, noise_px=0.001),
    )
    assert isinstance(settings.range_deg[0], float)


def test_defaults_without_file_and_with_an_empty_one(tmp_path: Path):
    assert load_settings(Options()) == Options()
    assert load_settings(Options(steps=9), _write(tmp_path / "a.yaml", "# nothing\n")) == Options(steps=9)


def test_a_list_of_records_of_which_some_fields_have_no_default(tmp_path: Path):
    settings = load_settings(Options(), _write(tmp_path / "a.yaml", "walk: [{length: 3}, {length: 1, count: 4}]"))
    assert settings.walk == (Step(length=3.0), Step(length=1.0, count=4))
    save_settings(settings, tmp_path / "b.yaml")
    assert load_settings(Options(), tmp_path / "b.yaml") == settings


def test_the_command_line_wins_over_the_file(tmp_path: Path):
    path = _write(tmp_path / "a.yaml", "steps: 5\nfilter: {order: 1, gate: 3}\n")
    settings = load_settings(Options(), path, {"filter.order": 0, "filter": {"is_robust": True}, "steps": 6})
    assert settings == Options(steps=6, filter=Filter(order=0, gate=3.0, is_robust=True))
    assert load_settings(settings, None, {"filter.gate": None}).filter.gate is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("stepz: 5", r"a.yaml: unknown key stepz \(did you mean steps\?\); allowed: space, steps, range_deg"),
        ("filter: {ordr: 1}", r"a.yaml: unknown key filter.ordr \(did you mean order\?\); allowed: order, noise_px"),
        ("steps: 1.5", "a.yaml: steps: expected a whole number, got 1.5"),
        ("steps: true", "a.yaml: steps: expected a whole number, got True"),
        ("filter: {is_robust: 1}", "a.yaml: filter.is_robust: expected true or false, got 1"),
        ("filter: {order: 7}", "a.yaml: filter.order: expected one of 0, 1, 2, got 7"),
        ("filter: {order: true}", "a.yaml: filter.order: expected one of 0, 1, 2, got True"),
        ("filter: {noise_px: -1}", "a.yaml: filter.noise_px: expected more than 0, got -1"),
        ("filter: {noise_px: much}", "a.yaml: filter.noise_px: expected a number, got 'much'"),
        ("filter: {gate: [1]}", "a.yaml: filter.gate: expected a number, got"),
        ("filter: 3", "a.yaml: filter: expected keys among order, noise_px, is_robust, gate, got 3"),
        ("filter:", "a.yaml: filter: expected keys among order"),
        ("range_deg: [1, 2, 3]", "a.yaml: range_deg: expected 2 values, got 3"),
        ("range_deg: [1, x]", r"a.yaml: range_deg\[1\]: expected a number, got 'x'"),
        ("range_deg: 4", "a.yaml: range_deg: expected a list, got 4"),
        ("weights: {edge: x}", "a.yaml: weights.edge: expected a number, got 'x'"),
        ("space: 5", "a.yaml: space: expected a text, got 5"),
        ("walk: [{count: 3}]", r"a.yaml: walk\[0\].length: expected a value, it has no default; got none"),
        ("walk: [{length: 1}, {length: -1}]", r"a.yaml: walk\[1\].length: expected more than 0, got -1"),
        ("walk: [{length: 1, counts: 1}]", r"a.yaml: unknown key walk\[0\].counts"),
        ("- 1", r"a.yaml: expected keys with values, got \[1\]"),
        ("steps: 5\nfilter: {order: 1", "a.yaml, line [23]: is no valid YAML"),
        ("steps: 5\nspace: a\nsteps: 6", "a.yaml, line 3: is no valid YAML .key 'steps' is given twice"),
    ],
)
def test_mistakes_name_the_file_and_the_key(tmp_path: Path, text: str, message: str):
    with pytest.raises(InputError, match=message) as caught:
        load_settings(Options(), _write(tmp_path / "a.yaml", text))
    assert "\n" not in str(caught.value)


def test_mistakes_on_the_command_line():
    with pytest.raises(InputError, match=r"command line: filter.noise_px: expected more than 0, got 0"):
        load_settings(Options(), None, {"filter.noise_px": 0})
    with pytest.raises(InputError, match=r"command line: unknown key filter.x"):
        load_settings(Options(), None, {"filter.x": 0})
    with pytest.raises(InputError, match=r"command line: health.min_overlap: expected 0 to 1, got 3.0"):
        load_settings(DEFAULTS["contour"], None, {"health.min_overlap": 3.0})  # which names itself "health.min_overlap"


def test_files_that_cannot_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    with pytest.raises(InputError, match=r"gone.yaml: cannot be read \(No such file or directory\)"):
        load_settings(Options(), tmp_path / "gone.yaml")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(InputError, match="expected a YAML text file in UTF-8"):
        load_settings(Options(), tmp_path / "binary.yaml")

    def refuse(*_: Any, **__: Any) -> bytes:
        raise PermissionError(13, "Permission denied")

    (tmp_path / "secret.yaml").write_text("")
    monkeypatch.setattr(Path, "read_bytes", refuse)
    with pytest.raises(InputError, match=r"secret.yaml: cannot be read \(Permission denied\)"):
        load_settings(Options(), tmp_path / "secret.yaml")


def test_saved_settings_are_complete_and_load_again(tmp_path: Path):
    settings = Options(background=Path("a.png"), weights={"edge": 0.5}, filter=Filter(order=0, noise_px=1e-7))
    save_settings(settings, tmp_path / "config.yaml", {"seed": 3, "input": Path("wave.mov"), "start_points": (1, 2.5)})
    stored = yaml.safe_load((tmp_path / "config.yaml").read_text())
    assert stored.pop("run") == {"torchhand": __version__, "seed": 3, "input": "wave.mov", "start_points": [1, 2.5]}
    names = ["space", "steps", "range_deg", "fingers", "background", "weights", "filter", "stages", "walk"]
    assert list(stored) == names
    assert stored["filter"] == {"order": 0, "noise_px": 1e-7, "is_robust": False, "gate": None}
    assert load_settings(Options(), tmp_path / "config.yaml") == settings


def test_records_in_a_list_come_back_and_their_mistakes_are_named(tmp_path: Path):
    options = Options(stages=(Filter(order=0), Filter(noise_px=0.5), Filter()))
    save_settings(options, tmp_path / "saved.yaml")
    assert load_settings(Options(), tmp_path / "saved.yaml") == options
    shorter = load_settings(Options(), _write(tmp_path / "short.yaml", "stages: [{order: 0}]"))
    assert shorter.stages == (Filter(order=0),)
    for text, message in (
        ("stages: [{ordr: 0}]", r"stages\[0\]\.ordr; did you mean|unknown key stages\[0\]\.ordr"),
        ("stages: [{}, {noise_px: -1}]", r"stages\[1\]\.noise_px: expected more than 0, got -1"),
        ("stages: [3]", r"stages\[0\]: expected keys with values, got 3"),
    ):
        with pytest.raises(InputError, match=message):
            load_settings(Options(), _write(tmp_path / "bad.yaml", text))
