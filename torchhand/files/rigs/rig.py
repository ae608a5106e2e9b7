"""Several calibrated cameras from a file or folder of any known format, checked for contradictions."""

from collections.abc import Sequence
from pathlib import Path

from torchhand.errors import InputError
from torchhand.files.cameras import (
    OPENCV_SUFFIXES,
    aniposelib_entries,
    camera_of_entry,
    colmap_entries,
    lens_files,
    load_cameras,
    opencv_entries,
    plain_text_entries,
)
from torchhand.files.disk import expanded, short, suggestion
from torchhand.files.pictures import natural_key, open_source
from torchhand.files.rigs.views import view_paths
from torchhand.geometry import Camera, Rig, common_view, look_away, rig_size, suspected_reading

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254}
"""Metres."""

_FORMATS = (
    "cameras.json, OpenCV's YAML or XML (.yml, .yaml, .xml), aniposelib's TOML, COLMAP's text (cameras.txt and"
    " images.txt), or c0.dat with rot_trans_c0.dat"
)
_LONGEST_UNIT = 1e3  # metres; cameras are some units apart
_NO_METRES = 50.0  # no rig for a hand is so large
_LARGE = 5.0


def load_rig(path: str | Path, *, unit: str | float | None = None, size: tuple[int, int] | None = None) -> Rig:
    """The cameras of a rig, in the order of their file or files, float64.

    path: a file of one of the formats, or a folder that holds them: cameras.json; OpenCV's YAML or XML, one file per
    camera or several cameras in one; aniposelib's TOML (calibration.toml, or the only .toml); cameras.txt and
    images.txt of COLMAP; cK.dat and rot_trans_cK.dat.
    unit: what one unit of the translations is: "m", "cm", "mm", "inch", or a number of metres. Without it metres are
    expected, and translations that can hardly be metres are refused.
    size: width and height of the pictures, px, for formats that do not tell; videos beside the files do too.

    Raises InputError: unreadable files; rotations that are none, focal lengths that are not positive, a principal point
    outside the picture, equal names; cameras of which no two see anything together, with what is probably wrong if
    another reading of the rotations makes sense. `rig_notes` tells of what is only suspicious.
    """
    path = expanded(path)
    factor = unit_in_metres(unit)
    cameras = Rig(_cameras(path, size)).scaled(factor)
    _check(path, cameras)
    if unit is None and rig_size(cameras) > _NO_METRES:
        raise InputError(f"{path}: expected metres, but {_extent(cameras)}; {_units_that_fit(cameras)}")
    return cameras


def rig_notes(cameras: Sequence[Camera]) -> list[str]:
    """One line for everything that is suspicious in a rig and yet may be right."""
    notes = []
    if rig_size(cameras) > _LARGE:
        notes.append(f"{_extent(cameras)}, if the unit is metres; {_units_that_fit(cameras)}")
    if len(cameras) < 2:
        return notes
    reading = suspected_reading(cameras)
    if reading is not None:
        notes.append(f"the cameras would look at one place if {reading}; as given they do not")
    seeing = common_view(cameras).tolist()
    if not all(seeing):
        outside = ", ".join(camera.name for camera, sees in zip(cameras, seeing, strict=True) if not sees)
        inside = ", ".join(camera.name for camera, sees in zip(cameras, seeing, strict=True) if sees)
        notes.append(f"no point is seen by all cameras: {inside} share a volume that {outside} cannot see")
    return notes


def unit_in_metres(unit: str | float | None, *, others: Sequence[str] = ()) -> float:
    """Metres of one unit; 1 for None. others: words that are allowed besides. Raises InputError naming all that are
    allowed."""
    if unit is None:
        return 1.0
    if isinstance(unit, str) and unit in UNITS:
        return UNITS[unit]
    try:
        value = float(unit)
    except ValueError:
        allowed = (*UNITS, *others)
        hint = suggestion(str(unit), allowed)
        raise InputError(
            f"unit: expected one of {', '.join(allowed)} or a number of metres, got {short(unit)}{hint}"
        ) from None
    if not 0 < value <= _LONGEST_UNIT:
        raise InputError(f"unit: expected a number of metres above 0, at most {_LONGEST_UNIT:g}, got {short(unit)}")
    return value


def _cameras(path: Path, size: tuple[int, int] | None) -> list[Camera]:
    kind, files = _format(path)
    if kind == "json":
        return load_cameras(files[0])
    if kind == "opencv":
        entries = [entry for file in files for entry in opencv_entries(file, size=size)]
    elif kind == "toml":
        entries = aniposelib_entries(files[0])
    elif kind == "colmap":
        entries = colmap_entries(files[0])
    else:
        entries = plain_text_entries(files[0], lambda i, count: size or _size_of_view(files[0], i, count))
    return [camera_of_entry(where, entry) for where, entry in entries]


def _format(path: Path) -> tuple[str, list[Path]]:
    """Format, and its files (COLMAP, plain text: the folder)."""
    if path.is_dir():
        return _format_of_folder(path)
    try:
        start = path.read_bytes()[:4096]
    except FileNotFoundError:
        raise InputError(f"{path}: no such file or folder; expected {_FORMATS}") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    suffix, text = path.suffix.lower(), start.lstrip(b"\xef\xbb\xbf \t\r\n")
    if suffix == ".json" or text.startswith(b"{"):
        return "json", [path]
    if suffix in OPENCV_SUFFIXES or text.startswith((b"%YAML", b"<?xml")):
        return "opencv", [path]
    if suffix == ".toml":
        return "toml", [path]
    if path.name in ("cameras.txt", "images.txt"):
        return "colmap", [path.parent]
    if suffix == ".dat" and path in lens_files(path.parent):
        return "plain", [path.parent]
    raise InputError(f"{path}: is no file of cameras that is known; expected {_FORMATS}")


def _format_of_folder(folder: Path) -> tuple[str, list[Path]]:
    if (folder / "cameras.json").is_file():
        return "json", [folder / "cameras.json"]
    if (folder / "cameras.txt").is_file():
        return "colmap", [folder]
    if lens_files(folder):
        return "plain", [folder]
    files = sorted((file for file in folder.iterdir() if file.suffix.lower() in OPENCV_SUFFIXES), key=natural_key)
    if files:
        return "opencv", files
    tables = sorted(folder.glob("*.toml"), key=natural_key)
    named = [file for file in tables if file.name == "calibration.toml"]
    if named or len(tables) == 1:
        return "toml", (named or tables)[:1]
    raise InputError(f"{folder}: holds no cameras; expected {_FORMATS}")


def _size_of_view(folder: Path, index: int, count: int) -> tuple[int, int]:
    paths = view_paths(folder, [f"cam{i}" for i in range(count)])
    found = paths[index] or next((path for path in paths if path is not None), None)
    if found is None:
        raise InputError(
            f"{folder}: the size of the pictures is not known: no videos lie beside; give width and height"
        )
    with open_source(found) as source:
        return source.width, source.height


def _check(path: Path, cameras: Sequence[Camera]) -> None:
    names = [camera.name for camera in cameras]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"{path}: expected a different name for every camera, got {twice!r} twice")
    for camera in cameras:
        x, y = camera.intrinsics[:2, 2].tolist()
        if camera.kind == "pinhole" and not (0 <= x <= camera.width - 1 and 0 <= y <= camera.height - 1):
            raise InputError(
                f"{path}: {camera.name}: expected the principal point inside the picture of"
                f" {camera.width}x{camera.height} px, got ({x:.6g}, {y:.6g})"
            )
    if len(cameras) < 2:
        return
    reading = suspected_reading(cameras)
    if int(common_view(cameras).sum()) < 2:
        hint = f"they would if {reading}" if reading else "check R and t (X_cam = R X_world + t)"
        raise InputError(f"{path}: no two cameras see anything together; {hint}")
    if reading is not None and look_away(cameras):
        raise InputError(f"{path}: the cameras look away from each other's common point; they would not if {reading}")


def _extent(cameras: Sequence[Camera]) -> str:
    size = rig_size(cameras)
    if len(cameras) == 1:
        return f"the camera lies {size:.4g} from the origin"
    return f"cameras lie up to {size:.4g} apart"


def _units_that_fit(cameras: Sequence[Camera]) -> str:
    size = rig_size(cameras)
    fits = [f"unit {name} makes it {factor * size:.3g} m" for name, factor in UNITS.items() if factor * size <= _LARGE]
    return "; ".join(fits) if fits else "give the unit as a number of metres"
