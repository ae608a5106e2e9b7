"""`torchhand measure_status`: the table that comes with the package, and what is refused."""

import json
from pathlib import Path
from typing import Any

import pytest

from torchhand.cli.measure_status import _TABLE as TABLE
from torchhand.cli.measure_status import main
from torchhand.runs import settings_of


def test_the_table_of_the_package_tells_how_it_was_made() -> None:
    table: dict[str, Any] = json.loads(TABLE.read_text(encoding="utf-8"))
    command = table["command"].split()
    assert command[:2] == ["torchhand", "measure_status"]
    configs = command[command.index("--configs") + 1 : command.index("--pictures")]
    assert set(configs) == set(table) - {"command", "version", "pictures_without_hand"}
    for name in configs:
        settings_of(name)  # is still there
        health = table[name]["health"]
        for rates in health.values():
            assert 0 <= rates["found"] <= 1
        assert health["right"]["found"] > max(health["wrong"]["found"], health["none"]["found"])
        assert health["right"]["failing"] < min(health["wrong"]["failing"], health["none"]["failing"])


def test_too_few_pictures_are_an_error_of_the_user(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "rates.json"
    assert main(["--out", str(out), "--configs", "contour_planar", "--pictures", "2"]) == 2
    assert "--pictures" in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.slow
def test_hands_where_there_are_none_are_counted_beside_the_rest(tmp_path: Path) -> None:
    """Of a face and a portrait one at most is a hand to a tracker's first frame; what FILE said else stays."""
    out = tmp_path / "rates.json"
    out.write_text('{"contour_full": 1}')
    assert main(["--out", str(out), "--configs", "contour_planar", "--empty", "2"]) == 0
    table = json.loads(out.read_text(encoding="utf-8"))
    assert table["contour_full"] == 1
    found = table["pictures_without_hand"]
    assert found["pictures"] == 2
    for name in ("contour_planar", "fit_pose"):
        assert found[name]["reported"] == sum(found[name]["by_kind"].values())
    assert found["contour_planar"]["reported"] <= 1
