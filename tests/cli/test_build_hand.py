"""`torchhand build_hand`: the shipped folder is what it makes, a copy can be built, mistakes are told."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from torchhand.cli.build_hand import main, preview
from torchhand.files.hand_model import load_hand_model
from torchhand.files.locations import models_dir
from torchhand.files.urdf import read_skeleton

FOLDER = models_dir() / "generic_hand"


def test_it_builds_the_shipped_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "generic_hand"
    folder.mkdir()
    shutil.copy(FOLDER / "shape.json", folder)
    assert main(["--out", str(folder)]) == 0
    built_hand, shipped_hand = (read_skeleton(place / "hand.urdf") for place in (folder, FOLDER))
    torch.testing.assert_close(built_hand.rest_offset, shipped_hand.rest_offset, atol=1e-7, rtol=0)
    torch.testing.assert_close(built_hand.axis, shipped_hand.axis, atol=1e-7, rtol=0)
    built, shipped = (cv2.imread(str(place / "preview.png")) for place in (folder, FOLDER))
    assert built is not None
    assert shipped is not None, "run `torchhand build_hand` and commit the preview"
    assert built.shape == shipped.shape
    assert float(np.abs(built.astype(int) - shipped).mean()) < 0.5
    assert capsys.readouterr().out == f"saved {folder / 'hand.urdf'}\nsaved {folder / 'preview.png'}\n"


def test_the_preview_shows_three_postures_from_four_sides() -> None:
    picture = preview(load_hand_model(), tile_px=64)
    assert picture.shape == (3 * 64, 4 * 64, 3)
    shares = (picture != 128).any(-1).double().reshape(3, 64, 4, 64).mean((1, 3))
    assert float(shares.min()) > 0.02, "a hand in every tile"
    assert bool((shares[0, :2] > 1.2 * shares[1, :2]).all()), "an open hand is larger than a fist, from palm and back"


def test_what_it_refuses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--out", str(tmp_path)]) == 2
    assert capsys.readouterr().err == (
        f"torchhand build_hand: error: {tmp_path}: expected a model folder with shape.json; there is none\n"
    )
    (tmp_path / "shape.json").write_text("[]")
    assert main(["--out", str(tmp_path)]) == 2
    assert "expected JSON with a list 'parameters'" in capsys.readouterr().err
    assert not (tmp_path / "hand.urdf").exists()
