"""Where the shipped models and configurations are: inside the installed package, or in the checkout."""

from pathlib import Path

from torchhand.errors import InputError
from torchhand.files.disk.plain_files import expanded

_PACKAGE = Path(__file__).resolve().parents[2]


def models_dir() -> Path:
    """Folder with one sub-folder per hand model."""
    return _shipped("models")


def configs_dir() -> Path:
    """Folder with one YAML file per named configuration."""
    return _shipped("configs")


def find_config(name: str | Path) -> Path:
    """The file meant by a path or by the name of a shipped configuration.

    `contour_planar`, `contour_planar.yaml` and `configs/contour_planar.yaml` find the shipped file from any folder.
    """
    path = expanded(name)
    if path.is_file():
        return path
    shipped = configs_dir() / f"{path.stem if path.suffix in ('.yaml', '.yml') else path.name}.yaml"
    if str(path.parent) in (".", "configs") and shipped.is_file():
        return shipped
    names = ", ".join(sorted(file.stem for file in configs_dir().glob("*.yaml"))) or "none"
    raise InputError(f"{path}: no such configuration; expected a YAML file or one of {names}")


def _shipped(name: str) -> Path:
    inside = _PACKAGE / name
    return inside if inside.is_dir() else _PACKAGE.parent / name
