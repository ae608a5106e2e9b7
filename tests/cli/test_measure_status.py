"""`torchhand measure_status`: the table that comes with the package, and what is refused."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
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


def test_photographs_need_pictures_without_a_hand_and_masks(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    hands, others, out = tmp_path / "hands", tmp_path / "others", tmp_path / "evidence.json"
    for folder in (hands, others):
        folder.mkdir()
        cv2.imwrite(str(folder / "a_1.png"), np.full((48, 64, 3), 128, np.uint8))
    assert main(["--out", str(out), "--photographs", str(hands)]) == 2
    assert "expected --without FOLDER beside it" in capsys.readouterr().err
    assert main(["--out", str(out), "--photographs", str(hands), "--without", str(others)]) == 2
    assert "expected a_1_mask.png beside a_1.png" in capsys.readouterr().err
    cv2.imwrite(str(hands / "a_1_mask.png"), np.full((48, 64), 255, np.uint8))
    assert main(["--out", str(out), "--photographs", str(hands), "--without", str(others)]) == 2
    assert "0 right hands and 1 pictures without a hand" in capsys.readouterr().err
    assert not out.exists()
