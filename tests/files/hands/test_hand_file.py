"""hand.json: the fitted shape."""

import json
from pathlib import Path
from typing import Any

import pytest

from torchhand.errors import InputError
from torchhand.files.hands.hand_file import load_hand, save_hand

NAMES = ("hand_length", "hand_breadth", "index_proximal")


def _saved(path: Path) -> Path:
    save_hand(path, NAMES, (0.19, 0.085, 0.245), "left", {"picture": "a.png", "rms_px": 0.7}, units=("m", "m", "/HL"))
    return path


def test_what_is_written_comes_back(tmp_path: Path):
    path = _saved(tmp_path / "hand.json")
    hand = load_hand(path, NAMES)
    assert hand.side == "left"
    assert hand.values == {"hand_length": 0.19, "hand_breadth": 0.085, "index_proximal": 0.245}
    assert hand.units["index_proximal"] == "/HL"
    assert hand.provenance == {"picture": "a.png", "rms_px": 0.7}
    reordered = load_hand(path, NAMES[::-1])
    assert list(reordered.values) == list(NAMES[::-1])
    assert load_hand(path) == hand


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("format", "other", "hand.json: expected a hand file .* got 'other'"),
        ("side", "both", "hand.json: side: expected one of left, right, got 'both'"),
        ("shape", [1], r"hand.json: shape: expected numbers by name, got \[1\]"),
        ("units", None, "hand.json: units: expected keys with values, got None"),
        ("shape", {"hand_length": 0.19}, "hand.json: shape: lacks hand_breadth, index_proximal"),
        (
            "shape",
            {"hand_lenght": 0.19, "hand_breadth": 0.08, "index_proximal": 0.2},
            r"shape: unknown hand_lenght \(did you mean hand_length\?\); allowed: hand_length, hand_breadth",
        ),
        (
            "shape",
            {"hand_length": "long", "hand_breadth": 0.08, "index_proximal": 0.2},
            "hand.json: shape.hand_length: expected a finite number, got 'long'",
        ),
        ("units", {"hand_length": ["m"]}, r"hand.json: units.hand_length: expected a text, got \['m'\]"),
    ],
)
def test_mistakes_are_named(tmp_path: Path, key: str, value: Any, message: str):
    path = _saved(tmp_path / "hand.json")
    path.write_text(json.dumps({**json.loads(path.read_text()), key: value}))
    with pytest.raises(InputError, match=message):
        load_hand(path, NAMES)


def test_files_that_are_none(tmp_path: Path):
    with pytest.raises(InputError, match=r"gone.json: no such file"):
        load_hand(tmp_path / "gone.json")
    (tmp_path / "list.json").write_text("[1, 2]")
    with pytest.raises(InputError, match=r"list.json: expected a hand file .* got \[1, 2\]"):
        load_hand(tmp_path / "list.json")


def test_numbers_that_are_none_are_never_written(tmp_path: Path):
    with pytest.raises(ValueError, match="JSON"):
        save_hand(tmp_path / "hand.json", ["hand_length"], [float("nan")], "right", {})
    assert list(tmp_path.iterdir()) == []
