"""`torchhand measure_quality`: the models that come with the package, and what is refused."""

import json
from pathlib import Path
from typing import Any

import pytest

from torchhand.cli.measure_quality import _TABLE as TABLE
from torchhand.cli.measure_quality import main


def test_the_models_of_the_package_tell_right_from_wrong() -> None:
    """On sequences that they were not fitted to, and as often as they say, where more than two recordings tell; those
    give up to 50 estimates each, in which a hand is right or wrong throughout. Single pictures tell one by one."""
    table: dict[str, Any] = json.loads(TABLE.read_text(encoding="utf-8"))
    assert set(table) == {"contour", "distance", "rig", "single"}
    for method, models in table.items():
        assert models["command"].startswith("torchhand measure_quality --methods")
        for part in ("finger", "hand"):
            assert models[part]["auc"] > 0.65
            for mean, share, number in models[part]["mean_right_number"].values():
                if method == "single" or number > 100:
                    assert abs(mean - share) < 0.12 + 1.5 / number**0.5


@pytest.mark.slow
def test_too_few_sequences_are_an_error_of_the_user(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "quality.json"
    assert main(["--out", str(out), "--methods", "contour", "--sequences", "1"]) == 2
    assert "--sequences" in capsys.readouterr().err
    assert not out.exists()
