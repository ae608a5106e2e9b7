"""Array files of numpy that are cut off or damaged: one clear line, whatever breaks inside the readers."""

import random
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from torchhand.errors import InputError
from torchhand.files.disk.array_file import opened_arrays


def _npy(path: Path) -> None:
    np.save(path, np.arange(24.0).reshape(4, 3, 2))


def _npz(path: Path) -> None:
    np.savez(path, points=np.arange(24.0), names=np.array(["a", "b"]))


def _compressed(path: Path) -> None:
    np.savez_compressed(path, points=np.random.default_rng(0).random(400), names=np.array(["a", "b"]))


def _complaint(path: Path) -> str | None:
    try:
        with opened_arrays(path, complaint="expected points") as arrays:
            dict(arrays)
    except InputError as error:
        return str(error)
    return None


def test_arrays_are_read_by_name(tmp_path: Path) -> None:
    _npz(tmp_path / "a.npz")
    _npy(tmp_path / "a.npy")
    with opened_arrays(tmp_path / "a.npz", complaint="") as arrays:
        assert list(arrays) == ["points", "names"]
        np.testing.assert_array_equal(arrays["points"], np.arange(24.0))
    with opened_arrays(tmp_path / "a.npy", complaint="") as arrays:
        np.testing.assert_array_equal(arrays[""], np.arange(24.0).reshape(4, 3, 2))


@pytest.mark.filterwarnings("ignore:Reading `.npy` or `.npz` file required additional header parsing:UserWarning")
@pytest.mark.parametrize(("suffix", "write"), [("npy", _npy), ("npz", _npz), ("npz", _compressed)])
def test_every_damage_is_one_line(suffix: str, write: Callable[[Path], None], tmp_path: Path) -> None:
    """Single bytes changed, and the file cut off, everywhere: read, or refused with the file's name."""
    path = tmp_path / f"broken.{suffix}"
    write(path)
    whole, dice, refused = path.read_bytes(), random.Random(0), 0
    for _ in range(400):
        damaged = bytearray(whole)
        damaged[dice.choice((dice.randrange(len(whole)), dice.randrange(120), -1 - dice.randrange(200)))] ^= (
            1 << dice.randrange(8)
        )
        path.write_bytes(bytes(damaged) if dice.random() < 0.8 else whole[: dice.randrange(len(whole))])
        complaint = _complaint(path)
        refused += complaint is not None
        if complaint is not None:
            assert complaint.startswith(f"{path}: expected points (")
            assert "\n" not in complaint
            assert len(complaint) < len(str(path)) + 200
    assert refused > 20


def test_objects_are_not_executed(tmp_path: Path) -> None:
    path = tmp_path / "objects.npz"
    np.savez(path, points=np.array([None, print], dtype=object))
    with pytest.raises(InputError, match="expected points"), opened_arrays(path, complaint="expected points") as arrays:
        arrays["points"]
    np.save(tmp_path / "objects.npy", np.array([None, print], dtype=object))
    assert (
        _complaint(tmp_path / "objects.npy") == f"{tmp_path / 'objects.npy'}: expected points (it holds Python objects)"
    )


def test_what_is_no_array_file_is_told_without_numpys_advice(tmp_path: Path) -> None:
    (tmp_path / "a.npz").write_text("no arrays")
    assert (
        _complaint(tmp_path / "a.npz") == f"{tmp_path / 'a.npz'}: expected points (neither .npz nor .npy, or damaged)"
    )


def test_what_is_no_file(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "nothing.npz"):
        with pytest.raises(InputError, match="cannot be read"), opened_arrays(path, complaint=""):
            pass


def test_what_nobody_asks_for_is_not_unpacked(tmp_path: Path) -> None:
    """An archive of a megabyte that holds 304 under another name is read as if it did not."""
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        with archive.open("points.npy", "w") as member:
            np.lib.format.write_array(member, np.arange(24.0))
        with archive.open("zeros.npy", "w", force_zip64=True) as member:
            np.lib.format.write_array_header_1_0(member, {"descr": "|u1", "fortran_order": False, "shape": (19 << 24,)})
            for _ in range(19):
                member.write(bytes(1 << 24))
    assert path.stat().st_size < 2_000_000
    with opened_arrays(path, complaint="expected points") as arrays:
        assert list(arrays.chosen(["points", "others"])) == ["points"]
        assert list(arrays.small(arrays, 1000)) == ["points"]
        np.testing.assert_array_equal(arrays["points"], np.arange(24.0))
    with (
        pytest.raises(InputError, match=r"expected points \(ValueError: zeros: 304 MiB packed into"),
        opened_arrays(path, complaint="expected points") as arrays,
    ):
        dict(arrays)
