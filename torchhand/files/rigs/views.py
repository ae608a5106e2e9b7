"""Where the pictures of each camera of a rig lie: view_K/ folders, NAME/ folders, or one video per camera."""

import re
from collections.abc import Sequence
from pathlib import Path

from torchhand.errors import InputError
from torchhand.files.pictures import PICTURE_SUFFIXES, VIDEO_SUFFIXES, natural_key

_VIEW = re.compile(r"view_?\d+", re.IGNORECASE)
_NO_VIEW = re.compile(r"masks?(_?\d+)?", re.IGNORECASE)


def view_paths(folder: Path, names: Sequence[str]) -> list[Path | None]:
    """Folder of pictures or video of each of the named cameras, None where there is none.

    The camera in place K has view_K/, NAME/, NAME.mp4 or view_K.mp4 (any video suffix). Where no camera has, as many
    videos as cameras are taken in natural order. Raises InputError where the folder cannot be read.
    """
    content = _content(folder)
    by_name = {path.name if path.is_dir() else path.stem: path for path in reversed(content)}
    paths = [by_name.get(f"view_{i}", by_name.get(name)) for i, name in enumerate(names)]
    if any(path is not None for path in paths):
        return paths
    videos = [path for path in content if not path.is_dir()]
    if len(videos) == len(names):
        return list(videos)
    return paths


def mask_paths(folder: Path, count: int) -> list[Path | None]:
    """Folder of silhouettes masks_K/ of each of so many cameras, None where there is none.

    Raises InputError where the folder cannot be read.
    """
    by_name = {path.name: path for path in _content(folder) if path.is_dir()}
    return [by_name.get(f"masks_{view}") for view in range(count)]


def find_views(folder: Path) -> dict[str, Path]:
    """Name and place of all views of a folder whose cameras are not known yet, in natural order.

    Folders view_K/, else other folders with pictures (masks apart), else videos, else the pictures of the folder itself
    as the only view. Raises InputError where there is nothing of this.
    """
    content = _content(folder)
    folders = [path for path in content if path.is_dir() and not _NO_VIEW.fullmatch(path.name)]
    views = [path for path in folders if _VIEW.fullmatch(path.name)] or folders
    if views:
        return {path.name: path for path in views}
    videos = [path for path in content if path.suffix.lower() in VIDEO_SUFFIXES]
    if videos:
        return _named(videos)
    if pictures_in(folder):
        return {"cam0": folder}
    raise InputError(
        f"{folder}: holds no views; expected folders view_0, view_1, ... of pictures, or a video per camera"
    )


def pictures_in(folder: Path) -> list[Path]:
    """Pictures of a folder in natural order."""
    return sorted(
        (
            path
            for path in folder.iterdir()
            if path.suffix.lower() in PICTURE_SUFFIXES and path.is_file() and not path.name.startswith(".")
        ),
        key=natural_key,
    )


def _named(videos: list[Path]) -> dict[str, Path]:
    stems = [path.stem for path in videos]
    return {path.stem if stems.count(path.stem) == 1 else path.name: path for path in videos}


def _content(folder: Path) -> list[Path]:
    """Folders that hold pictures, then videos, each in natural order."""
    try:
        entries = sorted((path for path in folder.iterdir() if not path.name.startswith(".")), key=natural_key)
        folders = [path for path in entries if path.is_dir() and pictures_in(path)]
    except FileNotFoundError:
        raise InputError(f"{folder}: no such folder (expected view_0, view_1, ... or a video per camera)") from None
    except OSError as error:
        raise InputError(f"{folder}: cannot be read ({error.strerror or error})") from error
    return folders + [path for path in entries if path.suffix.lower() in VIDEO_SUFFIXES and path.is_file()]
