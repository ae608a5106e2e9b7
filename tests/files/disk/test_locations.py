"""Where shipped models and configurations are found."""

import os
from pathlib import Path

import pytest

from torchhand.errors import InputError
from torchhand.files.disk import locations, write_text
from torchhand.files.disk.locations import configs_dir, find_config, models_dir


def test_named_configurations(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    shipped = tmp_path / "shipped"
    shipped.mkdir()
    for name in ("contour_planar", "contour_full"):
        (shipped / f"{name}.yaml").write_text("")
    monkeypatch.setattr(locations, "configs_dir", lambda: shipped)
    monkeypatch.chdir(tmp_path)
    for name in ("contour_planar", "contour_planar.yaml", "configs/contour_planar.yaml"):
        assert find_config(name) == shipped / "contour_planar.yaml"
    own = tmp_path / "contour_planar.yaml"
    own.write_text("steps: 1")
    assert find_config("contour_planar.yaml").resolve() == own
    for name in ("contour_planer", "elsewhere/contour_planar.yaml"):
        with pytest.raises(
            InputError, match="no such configuration; expected a YAML file or one of contour_full, contour_planar"
        ):
            find_config(name)


def test_shipped_folders_are_found_in_the_package_before_the_checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    package = tmp_path / "torchhand"
    package.mkdir()
    monkeypatch.setattr(locations, "_PACKAGE", package)
    assert (models_dir(), configs_dir()) == (tmp_path / "models", tmp_path / "configs")
    (package / "models").mkdir()
    assert (models_dir(), configs_dir()) == (package / "models", tmp_path / "configs")


def test_a_pipe_is_not_replaced(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="pipe: expected a file to replace"):
        write_text(tmp_path / "pipe", "text")
    assert (tmp_path / "pipe").is_fifo()
