"""`torchhand build_hand`: the shipped folder is what it makes, a copy can be built, mistakes are told."""

import shutil
import zipfile
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from torchhand.cli.build_hand import main, mesh_preview, primitive_preview
from torchhand.files import load_hand_model, load_mesh, models_dir
from torchhand.files.hands import read_skeleton

FOLDER = models_dir() / "generic_hand"
PICTURES = ("preview.png", "mesh.png", "prior.png", "palm.png")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    copy = tmp_path / "generic_hand"
    copy.mkdir()
    for name in ("shape.json", "mesh.npz"):
        shutil.copy(FOLDER / name, copy)
    return copy


def members(path: Path) -> dict[str, bytes]:
    """What an npz holds; its own headers depend on the version of Python."""
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def test_it_builds_the_shipped_files(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = (folder / "mesh.npz").read_bytes()
    assert main(["--out", str(folder), "--keep-mesh"]) == 0
    assert (folder / "mesh.npz").read_bytes() == before
    built_hand, shipped_hand = (read_skeleton(place / "hand.urdf") for place in (folder, FOLDER))
    torch.testing.assert_close(built_hand.rest_offset, shipped_hand.rest_offset, atol=1e-7, rtol=0)
    torch.testing.assert_close(built_hand.axis, shipped_hand.axis, atol=1e-7, rtol=0)
    assert members(folder / "skeleton.npz") == members(FOLDER / "skeleton.npz"), "run build_hand and commit"
    for name in PICTURES:
        built, shipped = (cv2.imread(str(place / name)) for place in (folder, FOLDER))
        assert built is not None
        assert shipped is not None, "run `torchhand build_hand` and commit the pictures"
        assert built.shape == shipped.shape
        assert float(np.abs(built.astype(int) - shipped).mean()) < 0.5
    names = ("hand.urdf", "skeleton.npz", *PICTURES)
    assert capsys.readouterr().out == "".join(f"saved {folder / name}\n" for name in names)


@pytest.mark.slow
def test_it_builds_the_shipped_mesh(folder: Path) -> None:
    (folder / "mesh.npz").unlink()
    assert main(["--out", str(folder)]) == 0
    names = load_hand_model().shape_space.names
    built, shipped = (load_mesh(place / "mesh.npz", shape_names=names) for place in (folder, FOLDER))
    assert torch.equal(built.faces, shipped.faces)
    torch.testing.assert_close(built.vertices, shipped.vertices, atol=1e-6, rtol=0)
    torch.testing.assert_close(built.shape_basis, shipped.shape_basis, atol=1e-4, rtol=0)
    torch.testing.assert_close(built.corrective_basis, shipped.corrective_basis, atol=1e-5, rtol=0)


def test_the_pictures_show_every_posture_from_every_side() -> None:
    for picture, rows, columns in (
        (primitive_preview(load_hand_model(), tile_px=64), 3, 4),
        (mesh_preview(load_hand_model(), tile_px=64), 4, 6),
    ):
        assert picture.shape == (rows * 64, columns * 64, 3)
        fractions = (picture != 245).any(-1).double().reshape(rows, 64, columns, 64).mean((1, 3))
        assert float(fractions.min()) > 0.02, "a hand in every tile"
        assert bool((fractions[0, :2] > 1.2 * fractions[1, :2]).all()), (
            "an open hand is larger than a fist, palm and back"
        )


def test_what_it_refuses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--out", str(tmp_path)]) == 2
    assert capsys.readouterr().err == (
        f"torchhand build_hand: error: {tmp_path}: expected a model folder with shape.json; there is none\n"
    )
    (tmp_path / "shape.json").write_text("[]")
    assert main(["--out", str(tmp_path)]) == 2
    assert "expected JSON with a list 'parameters'" in capsys.readouterr().err
    assert not (tmp_path / "hand.urdf").exists()


def test_keeping_a_mesh_that_is_not_there(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "mesh.npz").unlink()
    assert main(["--out", str(folder), "--keep-mesh"]) == 2
    assert "mesh.npz: cannot be read" in capsys.readouterr().err
    assert not (folder / "hand.urdf").exists()
