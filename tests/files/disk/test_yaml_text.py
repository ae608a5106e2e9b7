"""YAML that is hostile: one line each, in no time and no memory."""

import pytest

from torchhand.errors import InputError
from torchhand.files.disk import read_yaml


def _bomb() -> str:
    lines = ["a: &a [x, x, x, x, x, x, x, x, x]"]
    lines += [
        f"{name}: &{name} [{', '.join(['*' + last] * 9)}]" for last, name in zip("abcdefghi", "bcdefghij", strict=True)
    ]
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[" * 3000 + "]" * 3000, "line 1: is no valid YAML .more than 32 levels"),
        ("a: " * 3000, "is no valid YAML"),
        ("a: " + "1" * 5000, "is no valid YAML .*digits"),
        ("a: 2026-13-45", "month must be in 1..12"),
        ("a: 2026-01-01T00:00:00+99:99", "is no valid YAML .*offset"),
        ("a: 0b_", "is no valid YAML .*invalid literal"),
        ("a: &a [*a]", "an alias that stands within itself"),
        (_bomb(), "more than 20000 values"),
        ("a: 1\na: 2", "line 2: is no valid YAML .key 'a' is given twice"),
    ],
)
def test_hostile_texts_are_one_line(text: str, reason: str):
    with pytest.raises(InputError, match=reason) as caught:
        read_yaml(text, "config.yaml")
    assert str(caught.value).startswith("config.yaml")
    assert "\n" not in str(caught.value)


def test_aliases_that_say_something_are_read():
    assert read_yaml("a: &a {x: 1}\nb: *a\nc: {<<: *a, y: 2}", "x") == {
        "a": {"x": 1},
        "b": {"x": 1},
        "c": {"x": 1, "y": 2},
    }
