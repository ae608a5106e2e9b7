"""`torchhand measure_quality`: the models that come with the package, and what is refused."""

import json
from pathlib import Path
from typing import Any

import pytest

from torchhand.cli.measure_quality import _TABLE as TABLE
from torchhand.cli.measure_quality import main

_MODELS: dict[str, Any] = json.loads(TABLE.read_text(encoding="utf-8"))
_PARTS = [(method, part) for method in ("contour", "distance", "rig", "single") for part in ("finger", "hand")]


def test_all_methods_have_models_and_a_command() -> None:
    assert set(_MODELS) == {method for method, _ in _PARTS}
    for models in _MODELS.values():
        assert models["command"].startswith("torchhand measure_quality --methods")


@pytest.mark.parametrize(("method", "part"), _PARTS)
def test_the_models_of_the_package_tell_right_from_wrong(method: str, part: str) -> None:
    """On sequences that they were not fitted to."""
    assert _MODELS[method][part]["auc"] > 0.65


@pytest.mark.parametrize(("method", "part"), _PARTS)
def test_what_they_tell_is_as_often_right_as_they_say(method: str, part: str) -> None:
    """On sequences that they were not fitted to."""
    for mean, share, number in _MODELS[method][part]["mean_right_number"].values():
        assert abs(mean - share) < 0.12 + 1.5 / number**0.5


@pytest.mark.slow
def test_too_few_sequences_are_an_error_of_the_user(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "quality.json"
    assert main(["--out", str(out), "--methods", "contour", "--sequences", "1"]) == 2
    assert "--sequences" in capsys.readouterr().err
    assert not out.exists()
